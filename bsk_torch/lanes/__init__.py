"""Element-wise tensor code as kernels in C++, whose lanes are environments."""
