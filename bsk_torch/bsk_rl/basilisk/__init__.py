"""What programs of bsk_rl import of Basilisk itself: log levels, units, orbital elements, attitudes, the message of a battery.

Replace ``Basilisk`` by ``bsk_torch.bsk_rl.basilisk`` in such imports where Basilisk is not installed. Modules of Basilisk that
simulate are not here; a part of a spacecraft is a Component of bsk_torch, see ``docs/how_to/own_component.md``.
"""
