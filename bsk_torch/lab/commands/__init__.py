"""Commands of the lab: what they declare, without torch, and what they do."""
