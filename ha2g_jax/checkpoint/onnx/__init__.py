"""The generator as an ONNX file for runtimes other than JAX, written node by node from the parameters."""
