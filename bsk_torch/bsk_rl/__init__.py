"""bsk_rl for one episode at a time, on the simulation of bsk_torch: the modules and names of bsk_rl 1.3.8."""
