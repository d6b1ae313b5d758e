"""A depth network as ONNX: python examples/export_depth.py MODEL [FILE]

MODEL is a name on Hugging Face or a folder. depth-anything/Depth-Anything-V2-Small-hf may be used commercially (Apache-2.0); the Base and Large models
may not (CC-BY-NC-4.0). The file takes one image of 518×518 and returns its inverse depth: streamsplat run clip.mp4 --depth onnx:depth.onnx
Needs: pip install torch transformers onnx
"""
import sys

import torch
import transformers


class Depth(torch.nn.Module):
    """The network with the map alone as its output."""

    def __init__(self, name):
        super().__init__()
        self.network = transformers.AutoModelForDepthEstimation.from_pretrained(name)

    def forward(self, image):
        return self.network(image).predicted_depth


image = torch.zeros(1, 3, 518, 518)
file = sys.argv[2] if len(sys.argv) > 2 else "depth.onnx"
torch.onnx.export(Depth(sys.argv[1]).eval(), (image,), file, input_names=["image"], output_names=["depth"], dynamo=False)
