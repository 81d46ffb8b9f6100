"""The paper's method on one screen, by the functions that the product runs.

`register`, `Registration.to_field` and `LanguageField.scores` do the same, with checks, files and choices around it;
tests/field/test_method.py holds them to the same bits. docs/method.md goes on from here.
Source: Dr. Splat (CVPR 2025), Sec. A and B; 3DGS (2023).
"""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from ..base.arrays import Embedding, Indices, Numbers
from ..kernels import Triples, splat_arrays, view_weights
from ..scene.gaussians import Gaussians
from ..scene.masks.features import ViewFeatures
from ..scene.views import View
from .building import encode_features
from .codes import PQ, PQCode, pq_code, untracked
from .evidence.aggregation import MEAN
from .evidence.columns import stacked
from .evidence.evidence import Evidence
from .learning import learn
from .registration import encoder_of, masks_of

TOPK = 40  # Gaussians of a pixel that count


def coded_features(
    gaussians: Gaussians, views: Sequence[View], features: Mapping[str, ViewFeatures], topk: int = TOPK
) -> tuple[Indices, PQCode]:
    """Register masks onto Gaussians and code what they become; return the rows that any mask sees, and their codes.

    views: undistorted. features: of each view, by its name; maps of the view's size.
    """
    splats = splat_arrays(gaussians)  # positions from a local origin, covariances R S S^T R^T (3DGS Eq. 6)
    ordered = sorted(views, key=lambda view: view.name)
    masks = [features[view.name] for view in ordered]

    # W_ij: sum over the pixels p of mask j of w_i(p) = a_i prod_{k<i} (1 - a_k) (3DGS Eq. 3), i among the top k of p
    triples = [view_weights(splats, view, of.mask_ids, topk) for view, of in zip(ordered, masks, strict=True)]
    counts = [len(of.embeddings) for of in masks]
    weights = stacked([partial(Triples, *part) for part in triples], counts, len(gaussians))

    # f_i = normalize(sum_j W_ij e_j / sum_j W_ij) (Sec. A "Training stage"); made block by block, when it is asked for
    embeddings = np.concatenate([of.embeddings for of in masks])
    means = MEAN(Evidence(weights, masks_of(ordered, counts), embeddings))
    seen = np.flatnonzero(means.present)

    # each f_i in L parts, each part the nearest of 256 centroids of k-means (Sec. B; Jegou et al. 2011)
    codebook = learn(means, PQ(), encoder_of(features, embeddings.shape[1]), threads=0, track=untracked).codebook
    assert codebook is not None
    codes, has_direction = encode_features(means.rows(seen), codebook, threads=0, track=untracked)
    return seen[has_direction], pq_code(codebook, codes)


def cosines(code: PQCode, query: Embedding) -> Numbers:
    """Return <q, c_i> / |c_i|, q the vector of a text or a picture: L look-ups of <q_l, centroid> (Sec. B)."""
    return code.scores((query / np.linalg.norm(query))[None])[0]
