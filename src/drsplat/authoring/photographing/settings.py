"""Settings of pictures."""

from dataclasses import asdict, dataclass

from ...errors import InputError
from ..filming.paths import FOV_BOUNDS_DEGREES, check_size

DEFAULT_SIZE_PIXELS = (1024, 768)
DEFAULT_FOV_DEGREES = 60.0
MAX_PICTURES = 10_000


@dataclass(frozen=True)
class PhotographSettings:
    """Settings for pictures of a scene.

    Attributes:
        number: pictures, 1 to 10,000; None for as many as coverage takes, 48 to 150.
        size: width and height in pixels.
        fov_degrees: from the top to the bottom of a picture.
        up: direction that is up in the pictures; None for what the scene itself suggests.
        time: of a scene that moves.
        background: RGB in [0, 1] behind the Gaussians.

    Raises:
        InputError: a number that is out of range.
    """

    number: int | None = None
    size: tuple[int, int] = DEFAULT_SIZE_PIXELS
    fov_degrees: float = DEFAULT_FOV_DEGREES
    up: tuple[float, float, float] | None = None
    time: float | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_size(self.size)
        if self.number is not None and not 1 <= self.number <= MAX_PICTURES:
            raise InputError(f"number: expected 1 to {MAX_PICTURES:,} pictures, got {self.number:,}")
        if not FOV_BOUNDS_DEGREES[0] <= self.fov_degrees <= FOV_BOUNDS_DEGREES[1]:
            raise InputError(
                f"fov: expected {FOV_BOUNDS_DEGREES[0]:g} to {FOV_BOUNDS_DEGREES[1]:g} degrees, "
                f"got {self.fov_degrees:g}"
            )
        if self.up is not None and not 0 < sum(number * number for number in self.up) < float("inf"):
            raise InputError(f"up: expected a direction of three finite numbers, got {self.up}")
        if not all(0 <= number <= 1 for number in self.background):
            raise InputError(f"background: expected red, green and blue from 0 to 1, got {self.background}")

    def json(self) -> dict[str, object]:
        """Return the settings for the record."""
        return asdict(self)
