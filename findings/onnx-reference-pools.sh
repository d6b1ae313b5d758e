#!/usr/bin/env bash
# Packages: onnx 1.23.2 (PyPI), its evaluator `onnx.reference.ReferenceEvaluator`, with numpy 2.4.6; onnxruntime 1.32.0 to compare with.
# Behaviour: the evaluator that defines the operators computes other pools than the operators' text. MaxPool over one or three dimensions with padding and
#   strides of 1 ends with IndexError, or with a shorter result under ceil_mode=1, while its shape inference has the full length. AveragePool with
#   ceil_mode=1, where the last window passes the end, moves all windows: those at the start average fewer values. MaxPool over two dimensions is right.
# Guess beforehand: the values of onnxruntime in each case.
# Valid by: onnx.checker; ONNX's Operators.md, MaxPool-22 and AveragePool-22: with pads given, output i starts at i·stride − pad at the start.
# Output seen:
#   MaxPool 5, pads 1: IndexError, expected 2 3 4 5 5 (inferred length 5)
#   MaxPool 5, pads 1, ceil_mode: 3 4 5 5, expected 2 3 4 5 5 (inferred length 5)
#   MaxPool 5x5, pads 1: as expected
#   MaxPool 4x4x4, pads 1: IndexError
#   AveragePool 4x4, strides 3, ceil_mode: 3.5 5 9.5 11, expected 6 8 14 16
# Consequence: a depth network with such pools cannot be checked against this evaluator. Our program runs depth networks in ONNX Runtime.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check onnx==1.23.2 onnxruntime==1.32.0 numpy==2.4.6
cat >try.py <<'END'
import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper
from onnx.reference import ReferenceEvaluator


def model(operator, sides, **attributes):
    node = helper.make_node(operator, ['x'], ['y'], **attributes)
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, *shape]) for name, shape in (('x', sides), ('y', [None] * len(sides)))]
    graph = helper.make_graph([node], 'pool', ends[:1], ends[1:])
    built = helper.make_model(graph, opset_imports=[helper.make_opsetid('', 22)], ir_version=10)
    onnx.checker.check_model(built)
    return built


def words(values):
    return ' '.join(f'{value:g}' for value in values.ravel())


def case(name, operator, sides, **attributes):
    built = model(operator, sides, **attributes)
    x = np.arange(1, np.prod(sides) + 1, dtype=np.float32).reshape(1, 1, *sides)
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    expected = onnxruntime.InferenceSession(built.SerializeToString(), options, providers=['CPUExecutionProvider']).run(None, {'x': x})[0]
    inferred = [side.dim_value for side in onnx.shape_inference.infer_shapes(built).graph.output[0].type.tensor_type.shape.dim]
    assert inferred == list(expected.shape), inferred
    try:
        found = ReferenceEvaluator(built).run(None, {'x': x})[0]
    except IndexError:
        found = None
    if found is not None and found.shape == expected.shape and np.array_equal(found, expected):
        return print(f'{name}: as expected')
    text = 'IndexError' if found is None else words(found)
    short = f', expected {words(expected)}' if expected.size <= 8 else ''
    print(f'{name}: {text}{short}' + (f' (inferred length {inferred[2]})' if len(sides) == 1 else ''))


case('MaxPool 5, pads 1', 'MaxPool', [5], kernel_shape=[3], pads=[1, 1])
case('MaxPool 5, pads 1, ceil_mode', 'MaxPool', [5], kernel_shape=[3], pads=[1, 1], ceil_mode=1)
case('MaxPool 5x5, pads 1', 'MaxPool', [5, 5], kernel_shape=[3, 3], pads=[1] * 4)
case('MaxPool 4x4x4, pads 1', 'MaxPool', [4, 4, 4], kernel_shape=[3] * 3, pads=[1] * 6)
case('AveragePool 4x4, strides 3, ceil_mode', 'AveragePool', [4, 4], kernel_shape=[3, 3], strides=[3, 3], ceil_mode=1)
END
found=$(tools/bin/python try.py)
echo "$found"
[ "$found" = 'MaxPool 5, pads 1: IndexError, expected 2 3 4 5 5 (inferred length 5)
MaxPool 5, pads 1, ceil_mode: 3 4 5 5, expected 2 3 4 5 5 (inferred length 5)
MaxPool 5x5, pads 1: as expected
MaxPool 4x4x4, pads 1: IndexError
AveragePool 4x4, strides 3, ceil_mode: 3.5 5 9.5 11, expected 6 8 14 16' ]
