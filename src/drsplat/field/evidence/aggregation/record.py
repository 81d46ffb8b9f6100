"""Record of a field's aggregator, and its JSON."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields

from ....errors import FormatError, InputError
from ....formats.json_files import as_number, excerpt
from .sampling import Sampling


@dataclass(frozen=True)
class AggregatorRecord:
    """Record of an aggregator: its name, the parameters of its steps, and the sampling of W where it is known."""

    name: str = "mean"
    parameters: Mapping[str, int | float] = field(default_factory=dict)
    sampling: Sampling | None = None


MEAN_RECORD = AggregatorRecord()


def record_json(record: AggregatorRecord) -> dict[str, object]:
    sampling = None if record.sampling is None else asdict(record.sampling)
    return {"name": record.name, "parameters": dict(record.parameters), "sampling": sampling}


def record_from_json(document: object, where: str) -> AggregatorRecord:
    """Read the record that `record_json` returned; without one, as in older files, features are means.

    Raises: FormatError: the document is no such record.
    """
    if document is None:
        return MEAN_RECORD
    if not isinstance(document, dict):
        raise FormatError(f"{where}: aggregator: expected an object, got {excerpt(document)}")
    name, parameters = document.get("name"), document.get("parameters")
    if not isinstance(name, str) or not isinstance(parameters, dict):
        raise FormatError(f"{where}: aggregator: expected a name and parameters")
    numbers = {key: as_number(value, f"{where}: aggregator: {excerpt(key)}") for key, value in parameters.items()}
    return AggregatorRecord(name, numbers, _sampling(document.get("sampling"), where))


def _sampling(document: object, where: str) -> Sampling | None:
    if document is None:
        return None
    if not isinstance(document, dict):
        raise FormatError(f"{where}: sampling: expected an object, got {excerpt(document)}")
    topk, first_hits, pixels, near = (document.get(field.name) for field in fields(Sampling))
    counted = all(count is None or type(count) is int for count in (topk, first_hits))
    if not counted or pixels not in ("all", "centre"):
        raise FormatError(
            f"{where}: sampling: expected topk and first_hits as integers or null, and pixels as 'all' or 'centre'"
        )
    try:
        distance = None if near is None else as_number(near, f"{where}: sampling: near")
        return Sampling(topk, first_hits, pixels, distance)
    except InputError as error:
        raise FormatError(f"{where}: sampling: {error}") from None
