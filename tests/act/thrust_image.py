"""Hybrid actions for tests: thrust, then drift or image one of the next targets, in five numbers or in four and a choice."""

import torch

from bsk_torch import act


class Mixed:
    """Commands of an action whose last column is -1 for a drift, or k for an image of the k-th next target."""

    def imaged(self, n_ahead):
        self.image = act.Image(n_ahead_image=n_ahead)

    def link_satellite(self, satellite):
        super().link_satellite(satellite)
        self.image.link_satellite(satellite)

    def commands(self, action, chosen, mask):
        """Commands of ``action`` [N, 4] and ``chosen`` [N]; none is -1."""
        drift = super().decide(action, mask)
        images = mask & (chosen >= 0)
        index = chosen.clamp(min=0)
        image = self.image.decide(index, images, index, torch.full_like(index, -1))
        longest = torch.minimum(image.duration, action[:, 3])
        mode, key = torch.where(images, image.mode, drift.mode), torch.where(images, image.key, -1)
        duration = torch.where(images, longest, drift.duration)
        return drift._replace(mode=mode, key=key, duration=duration, expected=torch.minimum(image.expected, duration))

    def begin(self, mask, decision):
        super().begin(mask, decision)
        self.image.begin(mask, decision)

    def end(self, mask, decision, event):
        """Count windows that have closed; an image action that its longest duration has ended missed nothing."""
        self.image.end(mask & (decision.duration < decision.command[:, 3]), decision, event)


class ThrustImageBox(Mixed, act.ImpulsiveThrust):
    """[dv_N (3), longest duration, k]: one Box."""

    def __init__(self, n_ahead=4, **options):
        super().__init__(**options)
        self.imaged(n_ahead)

    def bounds(self):
        low, high = super().bounds()
        return torch.cat([low, low.new_tensor([-1.0])]), torch.cat([high, high.new_tensor([self.image.n_actions - 1])])

    def names(self):
        return [*super().names(), "target"]

    def decide(self, action, mask):
        return self.commands(action[:, :4], action[:, 4].long(), mask)


class ThrustImageHybrid(Mixed, act.HybridAction, act.ImpulsiveThrust):
    """Values [dv_N (3), longest duration] and a choice: drift, or the k-th target."""

    def __init__(self, n_ahead=4, **options):
        act.ImpulsiveThrust.__init__(self, **options)
        self.imaged(n_ahead)

    def choices(self):
        return ["drift", *self.image.names()]

    def mask(self):
        drift = torch.ones(len(self.satellite.simulator.ticks), 1, dtype=torch.bool)
        return torch.cat([drift, self.satellite.find_next_opportunities(self.image.n_actions, "target").mask], 1)

    def decide(self, action, mask):
        return self.commands(action[:, :4], action[:, 4].long() - 1, mask)
