"""Types of the native core; shapes and meaning are documented in drsplat.kernels."""

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

compiler: str

def available_isas() -> list[str]: ...
def default_isa() -> str: ...
def crc32(bytes: bytes | memoryview, value: int) -> int: ...
def view_weights(
    means: Array,
    covariances: Array,
    opacities: Array,
    antialiased: bool,
    camera: Array,
    segment_ids: Array,
    topk: int,
    first_hits: int,
    threads: int,
    isa: str,
) -> tuple[Array, Array, Array, tuple[float, float, float, float, float]]: ...
def topk_contributions(
    means: Array,
    covariances: Array,
    opacities: Array,
    antialiased: bool,
    camera: Array,
    width: int,
    height: int,
    topk: int,
    first_hits: int,
    threads: int,
    isa: str,
) -> tuple[Array, Array]: ...
def render(
    means: Array,
    covariances: Array,
    opacities: Array,
    antialiased: bool,
    camera: Array,
    width: int,
    height: int,
    values: Array,
    background: Array,
    threads: int,
    isa: str,
) -> tuple[Array, Array, Array]: ...
def sh_colors(sh: Array, means: Array, center: Array, threads: int, isa: str) -> Array: ...
def dense_rows(a: Array, b: Array, threads: int, isa: str) -> Array: ...
def convolve(images: Array, weights: Array, bias: Array, stride: int, threads: int, isa: str) -> Array: ...
def weighted_rows(
    starts: Array, columns: Array, weights: Array, embeddings: Array, threads: int, isa: str
) -> Array: ...
def place_entries(
    rows: Array, columns: Array, weights: Array, first_column: int, next: Array, all_columns: Array, all_weights: Array
) -> None: ...
def release_workspaces() -> None: ...
def heaviest_labels(ids: Array, weights: Array, labels: Array, threads: int) -> Array: ...
def code_sums(points: Array, codes: Array, threads: int) -> tuple[Array, Array]: ...
def changed_columns(
    starts: Array,
    columns: Array,
    weights: Array,
    numbers: Array,
    more_starts: Array,
    more_columns: Array,
    more_weights: Array,
    threads: int,
) -> tuple[Array, Array, Array]: ...
def pq_encode(features: Array, centroids: Array, threads: int, isa: str) -> Array: ...
def keep_best(scores: Array, names: Array, found: Array, first: int, threads: int, isa: str) -> None: ...
def lookup_tables(centroids: Array, queries: Array, threads: int, isa: str) -> Array: ...

_Parts = tuple[object, ...]

def scan_scores(rows: _Parts, tables: _Parts, how: _Parts) -> Array: ...
def scan_above(
    rows: _Parts, tables: _Parts, how: _Parts, threshold: float, floor: Array | None
) -> tuple[Array, Array]: ...
def scan_top(rows: _Parts, tables: _Parts, how: _Parts, count: int) -> tuple[Array, Array]: ...
def scan_best(rows: _Parts, tables: _Parts, how: _Parts) -> tuple[Array, Array, Array]: ...

class TrainingPass:
    def forward(self) -> tuple[Array, Array]: ...
    def backward(self, image: Array, gradient: Array) -> tuple[Array, ...]: ...
    def backward_and_step(
        self,
        image: Array,
        gradient: Array,
        sh: Array,
        first: Array,
        second: Array,
        rate: float,
        step: int,
        beta1: float,
        beta2: float,
        epsilon: float,
        head_rate: float,
    ) -> tuple[Array, ...]: ...
    @property
    def seconds(self) -> dict[str, float]: ...

def training_pass(
    means: Array,
    log_scales: Array,
    quats: Array,
    logits: Array,
    sh: Array,
    antialiased: bool,
    camera: Array,
    width: int,
    height: int,
    active: int,
    background: Array,
    threads: int,
    isa: str,
) -> TrainingPass: ...
def photometric_loss(
    image: Array, target: Array, ssim_weight: float, threads: int, isa: str
) -> tuple[float, float, Array]: ...
def adam_step(
    parameter: Array,
    gradient: Array,
    first: Array,
    second: Array,
    rate: float,
    step: int,
    beta1: float,
    beta2: float,
    epsilon: float,
    head_rate: float,
    row: int,
    threads: int,
    isa: str,
) -> None: ...
def mixture_encode(
    values: Array,
    scales: Array,
    features: Array,
    starts: Array,
    columns: Array,
    further: Array,
    wanted: int,
    threads: int,
    isa: str,
) -> tuple[Array, Array, Array]: ...
def nearest_centres(points: Array, centres: Array, threads: int, isa: str) -> Array: ...
def nearest_members(
    values: Array, scales: Array, points: Array, groups: Array, members: Array, wanted: int, threads: int, isa: str
) -> Array: ...
def mixture_scores(parts: tuple[Array, ...], queries: Array, threads: int, isa: str) -> Array: ...
def mixture_select(
    parts: tuple[Array, ...], query: Array, threshold: float, floor: Array | None, threads: int, isa: str
) -> tuple[Array, Array]: ...
def mixture_top(parts: tuple[Array, ...], query: Array, count: int, threads: int, isa: str) -> tuple[Array, Array]: ...
def mixture_best(parts: tuple[Array, ...], queries: Array, threads: int, isa: str) -> tuple[Array, Array, Array]: ...
def boxes(
    means: Array,
    quats: Array,
    scales: Array,
    mass: Array,
    starts: Array,
    ids: Array,
    up: Array | None,
    outliers: float,
    strays: float,
    sparse: float,
    threads: int,
) -> tuple[Array, Array, Array]: ...
def lab_colors(image: Array, threads: int, isa: str) -> Array: ...
def small_regions(lab: Array, scale: float, least: int) -> Array: ...
def look(image: Array, layers: tuple[Array, ...], threads: int, isa: str) -> tuple[Array, Array]: ...
def people(image: Array, layers: tuple[Array, ...], threads: int, isa: str) -> Array: ...
def photo_graph(labels: Array, lab: Array, borders: Array, traits: Array) -> tuple[Array, Array, Array, Array]: ...
def flooded(heights: Array, markers: Array) -> Array: ...
def merge_order(graph: tuple[Array, ...], pixels: float, rule: tuple[Array, ...], isa: str) -> Array: ...
def pair_likelihoods(graph: tuple[Array, ...], pixels: float, rule: tuple[Array, ...], isa: str) -> Array: ...
def merged_regions(
    graph: tuple[Array, ...],
    pixels: float,
    rule: tuple[Array, ...],
    threshold: float,
    least_area: float,
    least_width: float,
    isa: str,
) -> Array: ...
def agglomerate(
    starts: Array,
    columns: Array,
    weights: Array,
    views: Array,
    embeddings: Array,
    edges: Array,
    thresholds: Array,
    rule: Array,
    threads: int,
) -> tuple[Array, Array, Array, Array, Array, Array]: ...
