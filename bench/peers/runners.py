"""One runner per runtime and precision: prepares a stage once, then runs it repeatedly."""
import json
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np


class Unavailable(Exception):
    """The runtime lacks this mode for the stage, or cannot run it on this machine."""


class Torch:
    name = 'torch'
    modes = {'f32': ('encoder', 'upsampler', 'decoder'), 'bf16': ('encoder', 'upsampler', 'decoder')}

    def __init__(self, stage, precision, module, inputs, threads):
        import torch
        torch.set_num_threads(threads)
        self.torch, self.module, self.precision = torch, module, precision
        self.inputs = [torch.from_numpy(x) for x in inputs]

    def run(self):
        torch = self.torch
        with torch.inference_mode(), torch.autocast('cpu', torch.bfloat16, enabled=self.precision == 'bf16'):
            return self.module(*self.inputs).float().numpy()


class OnnxRuntime:
    name = 'onnxruntime'
    modes = {'f32': ('encoder', 'upsampler', 'decoder'), 'int8': ('encoder',)}

    def __init__(self, stage, precision, module, inputs, threads):
        import onnxruntime
        import torch
        folder = Path(tempfile.mkdtemp(prefix='peers-onnx-'))
        path = folder / f'{stage}.onnx'
        torch.onnx.export(module, tuple(torch.from_numpy(x) for x in inputs), str(path), dynamo=True, external_data=True, verbose=False)
        if precision == 'int8':
            import onnx
            from onnxruntime.quantization import QuantType, quantize_dynamic
            # The exporter keeps the shapes that weights had before it transposed them; the quantizer infers shapes again.
            graph = onnx.load(path)
            del graph.graph.value_info[:]
            path = folder / f'{stage}-whole.onnx'
            onnx.save(graph, path)
            quantized = folder / f'{stage}-int8.onnx'
            quantize_dynamic(str(path), str(quantized), weight_type=QuantType.QInt8, per_channel=True, op_types_to_quantize=['MatMul', 'Gemm'])
            path = quantized
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads, options.log_severity_level = threads, 1, 3
        self.session = onnxruntime.InferenceSession(str(path), options, providers=['CPUExecutionProvider'])
        self.feed = dict(zip([i.name for i in self.session.get_inputs()], inputs))

    def run(self):
        return self.session.run(None, self.feed)[0]


class OpenVino:
    name = 'openvino'
    modes = {p: ('encoder', 'upsampler', 'decoder') for p in ('f32', 'bf16', 'int8')}

    def __init__(self, stage, precision, module, inputs, threads):
        import openvino
        import torch
        core = openvino.Core()
        capable = core.get_property('CPU', 'OPTIMIZATION_CAPABILITIES')
        if precision == 'bf16' and 'BF16' not in capable:
            raise Unavailable('no bf16 instructions: OpenVINO would run f32')
        graph = openvino.convert_model(module, example_input=tuple(torch.from_numpy(x) for x in inputs))
        graph.reshape({i: x.shape for i, x in enumerate(inputs)})
        if precision == 'int8':
            import nncf
            rows = [inputs, [np.ascontiguousarray(x[..., ::-1, :]) for x in inputs]]
            graph = nncf.quantize(graph, nncf.Dataset(rows), model_type=nncf.ModelType.TRANSFORMER, subset_size=len(rows))
        hint = 'bf16' if precision != 'f32' and 'BF16' in capable else 'f32'
        self.model = core.compile_model(graph, 'CPU', {
            'INFERENCE_NUM_THREADS': threads, 'NUM_STREAMS': 1, 'PERFORMANCE_HINT': 'LATENCY', 'INFERENCE_PRECISION_HINT': hint})
        self.inputs = inputs

    def run(self):
        return np.array(self.model(self.inputs)[0])


class Ours:
    """`streamsplat-bench serve` on a pipe: the same process keeps the weights, as a peer's session does."""
    name = 'streamsplat'
    modes = {p: ('encoder', 'upsampler', 'decoder') for p in ('f32', 'bf16', 'int8')}
    servers = {}

    def __init__(self, stage, precision, program, model, inputs_file, threads):
        key = precision
        if key not in self.servers:
            command = [program, 'serve', '--model', model, '--input', inputs_file, '--precision', precision, '--threads', str(threads)]
            self.servers[key] = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.stage, self.server = stage, self.servers[key]

    def ask(self, **request):
        self.server.stdin.write(json.dumps(request) + '\n')
        self.server.stdin.flush()
        line = self.server.stdout.readline()
        if not line:
            raise RuntimeError('streamsplat-bench serve ended')
        return json.loads(line)

    def run(self):
        from safetensors.numpy import load_file
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / 'out.safetensors')
            self.ask(stage=self.stage, write=path)
            return load_file(path)['out']

    def seconds(self):
        spent = self.ask(stage=self.stage)
        return spent['seconds'], spent['processor']


def seconds(runner):
    """Seconds of one run, by the clock and of the processor on all threads. Our runner measures inside its process, so that the pipe is not timed."""
    if isinstance(runner, Ours):
        return runner.seconds()
    start = time.perf_counter(), time.process_time()
    runner.run()
    return time.perf_counter() - start[0], time.process_time() - start[1]
