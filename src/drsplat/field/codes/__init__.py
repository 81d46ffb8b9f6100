"""Codes: what features are kept as and searched in. Product quantisation: one byte per sub-vector.

A plain codebook is the paper's. A residual one is what its authors publish: a code is then the
index of a coarse centroid plus the bytes of what that centroid leaves over.
Source: Dr. Splat Sec. B; Jegou et al. 2011.
"""

from ...base.working import Track, untracked
from ...formats.embedding_record import encoder_from_json
from .code import Best, Code, Hits
from .codebook import Codebook, Codes, codebook_from_tensors, load_codebook, save_codebook, train_codebook
from .official import OfficialRows, from_official_bytes, official_bytes, read_faiss_codebook
from .pq_code import PQCode, pq_code
from .specification import PQ, CodeSpecification, Mixture, Smaller, choose_code

__all__ = [
    "PQ", "Best", "Code", "CodeSpecification", "Codebook", "Codes", "Hits", "Mixture", "OfficialRows", "PQCode",
    "Smaller", "Track", "choose_code", "codebook_from_tensors", "encoder_from_json", "from_official_bytes",
    "load_codebook", "official_bytes", "pq_code", "read_faiss_codebook", "save_codebook", "train_codebook",
    "untracked",
]  # fmt: skip
