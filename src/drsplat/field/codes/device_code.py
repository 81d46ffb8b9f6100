"""Codes that are searched on a GPU: chosen where a field is loaded, and nowhere else."""

from dataclasses import dataclass, field
from functools import cached_property

from ...base.arrays import FloatRows, Numbers
from ...errors import InputError
from ...kernels import QueryTables, Scanning
from ...kernels.cuda import scanning
from ...kernels.cuda.devices import chosen_device
from ...kernels.cuda.engine import Engine, cuda_engine
from .code import Best, Code, Hits
from .pq_code import PQCode


@dataclass(frozen=True, eq=False)
class DevicePQCode(PQCode):
    """Product-quantised code that is searched on a GPU, where its rows lie from the first search on.

    Its arrays stay on the host as well, for all but the search. Scores, also those of `best` among many queries, are
    nearer to the exact ones than on the CPU.
    """

    engine: Engine = field(kw_only=True)

    def run(self, begin: int, end: int) -> PQCode:
        """Return all rows for a run that is all of them. Raises: InputError: another run: the GPU holds the whole."""
        if (begin, end) != (0, len(self)):
            raise InputError("codes on a GPU are searched as a whole")
        return self

    @cached_property
    def _device_rows(self) -> scanning.DeviceRows:
        return scanning.sent_rows(self.engine, self._rows)

    def _scan_scores(self, tables: QueryTables, how: Scanning) -> FloatRows:
        return scanning.scan_scores(self._device_rows, tables)

    def _scan_above(self, tables: QueryTables, threshold: float, floor: Numbers | None, how: Scanning) -> Hits:
        return Hits(*scanning.scan_above(self._device_rows, tables, threshold, floor))

    def _scan_top(self, tables: QueryTables, count: int, how: Scanning) -> Hits:
        return Hits(*scanning.scan_top(self._device_rows, tables, count))

    def _scan_best(self, tables: QueryTables, how: Scanning) -> Best:
        return Best(*scanning.scan_best(self._device_rows, tables))


def searched_on(code: Code, device: str) -> Code:
    """Return a code that is searched on a device. device: "cpu", "cuda", or "auto": CUDA where that can be.

    Raises: InputError: no such device, or a code that no GPU searches. MissingExtraError: no GPU can be used.
    """
    chosen = chosen_device(device)
    if chosen == "cpu" or (device == "auto" and not isinstance(code, PQCode)):
        return code
    return on_engine(code, cuda_engine())


def on_engine(code: Code, engine: Engine) -> DevicePQCode:
    """Return a code that is searched by an engine. Raises: InputError: of another kind than `PQCode`."""
    if not isinstance(code, PQCode):
        raise InputError(
            f"search device 'cuda': expected features kept as '{PQCode.kind}', got '{code.kind}', which only the CPU "
            "searches: take search device 'cpu' or 'auto', or register with product quantisation"
        )
    return DevicePQCode(code.codebook, code.grouped, code.coarse_ids, code.inverse_norms, engine=engine)
