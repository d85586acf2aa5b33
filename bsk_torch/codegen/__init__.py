"""Compiler of element-wise tensor code to C++ kernels whose vector lanes are environments.

Tensor code is traced into a graph (:mod:`.trace`, :mod:`.ir`), passes turn the graph into the statements of a loop
over ticks (:mod:`.passes`), a printer writes them as C++ (:mod:`.cpp`), compiled once and cached (:mod:`.build`).
:class:`bsk_torch.codegen.kernel.Kernel` is the result. Other devices than CPUs use torch's inductor (:mod:`.inductor`).
"""
