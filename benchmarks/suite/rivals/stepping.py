"""Steps of Adam; on a GPU they are recorded and played again: its small kernels take longer to start than to run."""

from collections.abc import Callable, Iterable
from typing import Any

import torch

EAGER = 3  # steps before one is recorded, which make what it needs


def adam(groups: Iterable[dict[str, Any]], device: torch.device, eps: float = 1e-8) -> torch.optim.Adam:
    """groups: of parameters with their rates, as torch takes them."""
    return torch.optim.Adam(groups, eps=eps, fused=True, capturable=device.type == "cuda")


def stepping(
    optimizer: torch.optim.Adam, loss: Callable[[], torch.Tensor], device: torch.device
) -> Callable[[], torch.Tensor]:
    """A function that takes a step down `loss`, which finds its inputs in the same places each time."""

    def step() -> torch.Tensor:
        optimizer.zero_grad(set_to_none=False)
        found = loss()
        found.backward()
        optimizer.step()
        return found.detach()

    return _Recorded(step, device) if device.type == "cuda" else step


def means_of(losses: torch.Tensor, most: int) -> list[float]:
    """Of up to so many stretches of steps."""
    return [float(part.mean()) for part in losses.tensor_split(min(most, len(losses))) if len(part)]


class _Recorded:
    """A CUDA graph of a step, after some that are taken as they come."""

    def __init__(self, step: Callable[[], torch.Tensor], device: torch.device) -> None:
        self.step, self.stream = step, _stream_of(device)
        self.calls, self.graph = 0, torch.cuda.CUDAGraph()

    def __call__(self) -> torch.Tensor:
        self.calls += 1
        if self.calls <= EAGER:
            return self._eager()
        if self.calls == EAGER + 1:
            with torch.cuda.graph(self.graph, stream=self.stream):
                self.found = self.step()
        self.graph.replay()
        return self.found

    def _eager(self) -> torch.Tensor:
        current = torch.cuda.current_stream()
        self.stream.wait_stream(current)
        with torch.cuda.stream(self.stream):
            found = self.step()
        current.wait_stream(self.stream)
        return found


_STREAMS: dict[torch.device, torch.cuda.Stream] = {}


def _stream_of(device: torch.device) -> torch.cuda.Stream:
    """One for all steps: a parameter's gradient is made on the stream that it was first made on."""
    return _STREAMS.setdefault(device, torch.cuda.Stream(device))
