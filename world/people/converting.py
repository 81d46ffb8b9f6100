"""Write the weights that find people: python -m world.people.converting MODEL.tflite --output network.safetensors

MODEL.tflite is `deeplabv3_mnv2_pascal_quant.tflite` of google-coral/test_data at commit 104342d (Apache-2.0): DeepLabv3
on MobileNetV2, taught on COCO and on PASCAL VOC 2012. Its layers stay the bytes that they are, in the order in which
`drsplat.kernels.photo_regions.people` uses them: NN.weight (window and inputs, outputs) of uint8, NN.scale (the step of
a weight, and the byte that is 0), NN.bias of float32. Needs the package tflite, which only parses.

Source: Chen et al. 2018, Encoder-Decoder with Atrous Separable Convolution; Sandler et al. 2018, MobileNetV2.
"""

import argparse
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save_file

SHA256 = "350af47fd346ea6d74b58833a351f583ba860e9806ec5bd292ff8d8f1f249398"
CONVOLUTION, DEPTHWISE = "CONV_2D", "DEPTHWISE_CONV_2D"


def layers(data: bytes) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the weight, scale and bias of each convolution, in order."""
    import tflite

    model = tflite.Model.GetRootAsModel(data, 0)
    graph = model.Subgraphs(0)
    names = {number: name for name, number in vars(tflite.BuiltinOperator).items() if isinstance(number, int)}
    for place in range(graph.OperatorsLength()):
        operator = graph.Operators(place)
        code = model.OperatorCodes(operator.OpcodeIndex())
        name = names[max(code.BuiltinCode(), code.DeprecatedBuiltinCode())]
        if name in (CONVOLUTION, DEPTHWISE):
            _, weight, bias = (graph.Tensors(i) for i in operator.InputsAsNumpy())
            numbers = _numbers(model, weight, np.uint8)
            order = (1, 2, 0, 3) if name == DEPTHWISE else (1, 2, 3, 0)
            flat = numbers.transpose(order).reshape(-1, numbers.shape[order[-1]])
            yield flat, _scale(weight), _numbers(model, bias, np.int32).astype(np.float32) * _scale(bias)[0]


def _numbers(model: Any, tensor: Any, kind: type) -> np.ndarray:
    return np.asarray(model.Buffers(tensor.Buffer()).DataAsNumpy()).view(kind).reshape(tensor.ShapeAsNumpy())


def _scale(tensor: Any) -> np.ndarray:
    steps = tensor.Quantization()
    return np.array([steps.ScaleAsNumpy()[0], steps.ZeroPointAsNumpy()[0]], np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path, metavar="MODEL.tflite")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE")
    arguments = parser.parse_args()
    data = arguments.model.read_bytes()
    if hashlib.sha256(data).hexdigest() != SHA256:
        raise SystemExit(f"{arguments.model}: expected the file whose SHA-256 is {SHA256}")
    tensors = {}
    for place, parts in enumerate(layers(data)):
        for part, array in zip(("weight", "scale", "bias"), parts, strict=True):
            tensors[f"{place:02}.{part}"] = np.ascontiguousarray(array)
    save_file(tensors, arguments.output)


if __name__ == "__main__":
    main()
