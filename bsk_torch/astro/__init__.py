"""Pure functions of astronomy and mechanics, on :class:`~bsk_torch.vec3.Vec3` and tensors of any batch shape."""
