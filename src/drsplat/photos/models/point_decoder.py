"""Mask decoder of a SAM that computes what all points share once: half the time of transformers', same answers.

Every point begins with the same image, so the first layer's projections of it are common. Encodings of places are
projected once instead of added to the image for every point. Tokens stay in one order until the masks are finished,
where transformers copies them between layouts. Weights and modules are those of the model.

Source: Kirillov et al. 2023 Sec. A (the two-way decoder); the names of modules in transformers 5.23.
"""

from typing import Any, NamedTuple

import numpy as np

from ...base.arrays import Float32


class Projection(NamedTuple):
    """Linear map of image tokens, (n, d) -> (n, k). offset, (n, k): its bias, and its result for position encodings."""

    weight: Any
    offset: Any

    def __call__(self, tokens: Any) -> Any:
        from torch.nn.functional import linear

        return linear(tokens, self.weight).add_(self.offset)


class PointDecoder:
    """Decoder of points on one image, with the modules of a SamModel, Sam2Model, Sam3TrackerModel or EdgeTamModel.

    features: from get_image_embeddings, one tensor, or three from fine to coarse.
    """

    def __init__(self, model: Any, features: Any):
        self._model, self._decoder, transformer = model, model.mask_decoder, model.mask_decoder.transformer
        *fine, coarse = features if isinstance(features, list | tuple) else [features]
        nothing = model.prompt_encoder.no_mask_embed.weight.reshape(-1, 1, 1)
        self._image, self._side = (coarse[0] + nothing).flatten(1).T.contiguous()[None], coarse.shape[-1]  # row by row
        places = model.get_image_wide_positional_embeddings()[0].flatten(1).T
        self._layers = []
        for layer in transformer.layers:
            there, back = layer.cross_attn_token_to_image, layer.cross_attn_image_to_token
            self._layers.append((layer, _stacked([there.k_proj, back.q_proj], [there.v_proj], places)))
        self._last = transformer.final_attn_token_to_image
        self._last_projection = _stacked([self._last.k_proj], [self._last.v_proj], places)
        finest, finer = fine or (None, None)
        self._doublings = (
            _doubling(self._decoder.upscale_conv1, finer, self._side, 1),
            _doubling(self._decoder.upscale_conv2, finest, self._side, 2),
        )
        # the output tokens; the masks are the last four, of which the first is not used
        ahead = [self._decoder.obj_score_token.weight] if hasattr(self._decoder, "obj_score_token") else []
        self._outputs = [*ahead, self._decoder.iou_token.weight, self._decoder.mask_tokens.weight]

    def answers(self, points: Float32[np.ndarray, "p 2"]) -> tuple[Any, Any]:
        """Return three masks' logits for each point, (p, 3, h, w), and their predicted IoU, (p, 3).

        points: x, y in pixels of the model's square.
        """
        import torch

        placed = torch.from_numpy(points).to(self._image.device)[None, :, None]
        labels = torch.ones(placed.shape[:3], dtype=torch.int64, device=placed.device)
        prompts, _ = self._model.prompt_encoder(
            input_points=placed, input_labels=labels, input_boxes=None, input_masks=None
        )
        first = torch.cat([torch.cat(self._outputs).expand(len(points), -1, -1), prompts[0]], 1)
        queries, tokens = first, self._image
        for layer, projection in self._layers:
            queries, tokens = _through(layer, projection, queries, tokens, first)
        keys, values = self._last_projection(tokens).chunk(2, -1)
        queries = queries + _output(self._last, _attend(self._last, self._last.q_proj(queries + first), keys, values))
        queries = self._decoder.transformer.layer_norm_final_attn(queries)
        *_, iou, _, small, medium, large = queries[:, : sum(map(len, self._outputs))].unbind(1)
        scores = self._decoder.iou_prediction_head(iou)[:, 1:]
        return self._masks(tokens, (small, medium, large)), scores

    def _masks(self, tokens: Any, chosen: tuple[Any, ...]) -> Any:
        """Upscale the image twice and multiply it with the weights that the tokens of three masks give."""
        import torch
        from torch.nn.functional import gelu, layer_norm

        norm, networks, side = self._decoder.upscale_layer_norm, self._decoder.output_hypernetworks_mlps, self._side
        parts = self._doublings[0](tokens).unflatten(-1, (4, -1))  # of each token, its 2 x 2 halves
        parts = gelu(layer_norm(parts, parts.shape[-1:], norm.weight, norm.bias, norm.eps)).flatten(1, 2)
        parts = gelu(self._doublings[1](parts).unflatten(-1, (4, -1))).flatten(1, 2)
        weights = torch.stack([network(token) for network, token in zip(networks[1:], chosen, strict=True)], 1)
        masks = (weights @ parts.transpose(1, 2)).view(len(parts), 3, side, side, 2, 2, 2, 2)
        return masks.permute(0, 1, 2, 4, 6, 3, 5, 7).reshape(len(parts), 3, 4 * side, 4 * side)


def _through(layer: Any, projection: Projection, queries: Any, tokens: Any, first: Any) -> tuple[Any, Any]:
    """Run one layer: self-attention of the tokens, to the image, MLP, and attention of the image to the tokens."""
    own, there, back = layer.self_attn, layer.cross_attn_token_to_image, layer.cross_attn_image_to_token
    asking = queries if layer.skip_first_layer_pe else queries + first
    mixed = _output(own, _attend(own, own.q_proj(asking), own.k_proj(asking), own.v_proj(queries)))
    queries = layer.layer_norm1(mixed if layer.skip_first_layer_pe else queries + mixed)
    keys, image_queries, values = projection(tokens).chunk(3, -1)
    queries = layer.layer_norm2(queries + _output(there, _attend(there, there.q_proj(queries + first), keys, values)))
    queries = layer.layer_norm3(queries + layer.mlp(queries))
    seen = _attend(back, image_queries, back.k_proj(queries + first), back.v_proj(queries))
    return queries, layer.layer_norm4(_output(back, seen).add_(tokens))


def _attend(block: Any, queries: Any, keys: Any, values: Any) -> Any:
    """Compute attention of projected (p, n, d) tokens. The image's are (1, n, d) while all points share it."""
    from torch.nn.functional import scaled_dot_product_attention

    points, count = max(len(queries), len(keys)), queries.shape[1]
    if len(keys) == 1:  # queries of all points in one pass over the keys that they share
        queries = queries.reshape(1, -1, queries.shape[-1])
    queries = queries.expand(len(keys), -1, -1)
    heads = [rows.unflatten(-1, (block.num_attention_heads, -1)).transpose(1, 2) for rows in (queries, keys, values)]
    return scaled_dot_product_attention(*heads).transpose(1, 2).reshape(points, count, -1)


def _output(block: Any, rows: Any) -> Any:
    """Apply the last projection of an attention, whose name differs between SAM and its successors."""
    return (block.o_proj if hasattr(block, "o_proj") else block.out_proj)(rows)


def _stacked(placed: list[Any], plain: list[Any], places: Any) -> Projection:
    """Stack linear layers to one map of image tokens; those of `placed` see tokens plus position encodings."""
    import torch

    offsets = [layer(places) for layer in placed] + [layer.bias.expand(len(places), -1) for layer in plain]
    return Projection(torch.cat([layer.weight for layer in (*placed, *plain)]), torch.cat(offsets, 1))


def _doubling(conv: Any, finer: Any | None, side: int, level: int) -> Projection:
    """Return a transposed convolution of 2 x 2 as a map of tokens to four parts, plus finer features (1, c, h, w).

    level: how often the tokens' grid was doubled with it.
    """
    weight = conv.weight.permute(2, 3, 1, 0).flatten(0, 2).contiguous()
    if finer is None:
        return Projection(weight, conv.bias.repeat(4))
    parts = finer[0].reshape(-1, side, *[2] * level, side, *[2] * level)
    order = [axis for n in range(level + 1) for axis in (1 + n, 2 + level + n)]
    return Projection(weight, (parts.permute(*order, 0) + conv.bias).reshape(-1, len(weight)).contiguous())
