"""A rolling-horizon schedule of images: the first image of the best sequence that a beam search finds at each decision.

It knows what the satellite can know: places, sizes, values and forecasts, the windows of the next 64 images, its orbit and its
attitude. The search has its own model of turns, whose time depends on the angle between the directions of two images at the time
of the first one. Whether an image that has not been taken is clear is never read. Sequences are judged by what they pay on
average, later images less, and by what the two best sites would pay that can still be taken after the last image.

The numbers of the turns are a fit of absolute errors to 2,235 turns of the rule *commit* with random actions in 40 percent of the
cases, in 128 episodes and 2 core-seconds: half of them last between 1.3 s less and 2.2 s more than predicted. Turns of more than
15 degrees sometimes overshoot and last a minute longer. So the first images of the best sequences are tried in copies of the
episode, which fly one turn each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, cast

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor

from bsk_torch.astro.ephemeris import EARTH_ROTATION_RATE
from bsk_torch.env import SatelliteTasking
from bsk_torch.rl.rules.targets import image_actions
from bsk_torch.sats.bound_access import BoundAccessSatellite
from bsk_torch.sats.imaging import BoundImagingSatellite
from bsk_torch.tasks.sites.scene import Sites

TURN = (-13.2, 87.3)
"""Time of a turn: a constant, s, and the time for the square root of one radian, s."""

AFTER_OPENING = 1.0
"""Time from the opening of a window to the image of a satellite that waits for it, s."""


class Judgment(NamedTuple):
    """Numbers by which sequences are judged.

    Attributes:
        patience: Time that divides the worth of what is taken later by e, s.
        each: Time for each further image of a site, s.
        reserve: Time between an image and the end of its window, at least, s.
    """

    patience: float = 150.0
    each: float = 20.0
    reserve: float = 3.0


class Ahead(NamedTuple):
    """The next K images of N satellites.

    Attributes:
        place: Places in Earth-fixed axes, 1,000 km, [N, K, 3].
        open: Time until the window opens, s, [N, K].
        close: Time until the window or the episode ends, s, [N, K]; minus infinity for padding.
        bit: A power of two for each image of a site, [N, K].
        members: Sum of the bits of the images of its site that are among the K, [N, K].
        earlier: The same of those of them that close no later, [N, K].
        same: Whether two images are of one site, as 0 or 1, [N, K, K].
        leads: Whether the image is the first of its site, [N, K].
        worth: What sets of images of the site, by the sum of their bits, are expected to add to what it has paid, [N, K, 64].
    """

    place: Tensor
    open: Tensor
    close: Tensor
    bit: Tensor
    members: Tensor
    earlier: Tensor
    same: Tensor
    leads: Tensor
    worth: Tensor


def expected_worth(scenario: Sites, clear: Tensor, size: Tensor, done: Tensor) -> Tensor:
    """Return what each set of images adds to the paid part of a site on average, [..., 2^n], in the order of sums of bits.

    Args:
        scenario: The scenario, for its gain.
        clear: Probability that each image is clear, independently, [..., n].
        size: Number of images of the site, [...].
        done: Number of its clear images taken, [...].
    """
    n = clear.shape[-1]
    number = torch.ones(*clear.shape[:-1], 1, 1, dtype=clear.dtype)  # probability of 0 to n clear images in each set
    number = torch.nn.functional.pad(number, (0, n))
    for k in range(n):
        p = clear[..., k, None, None]
        more = number * (1.0 - p) + torch.nn.functional.pad(number, (1, 0))[..., :-1] * p
        number = torch.cat([number, more], -2)
    counts = torch.arange(n + 1, dtype=clear.dtype, device=clear.device)
    paid = scenario.gain((done.unsqueeze(-1) + counts) / size.unsqueeze(-1))
    return ((paid - paid[..., :1]).unsqueeze(-2) * number).sum(-1)


def look_ahead(satellite: BoundAccessSatellite, images: int) -> Ahead:
    """Return what is known of the next ``images`` images of each satellite."""
    scenario: Sites = satellite.scenario
    look_up, now = satellite.simulator.look_up, satellite.simulator.sim_time.unsqueeze(1)
    windows = satellite.find_next_opportunities(images, "target")
    site, number = windows.place // scenario.most, windows.place % scenario.most
    same = (site.unsqueeze(2) == site.unsqueeze(1)) & windows.mask.unsqueeze(1) & windows.mask.unsqueeze(2)
    bit = 2**number
    of_site = same * bit.unsqueeze(1)
    size, done = look_up(scenario.size, site), look_up(scenario.done, site)
    clear = (1.0 - scenario.risks).unflatten(1, (-1, scenario.most)).float()
    value = (look_up(scenario.priority, windows.place) * size).float()
    closes = torch.minimum(windows.close, satellite.time_limit.unsqueeze(1)) - now
    return Ahead(
        place=windows.r_LP_P.float() * 1e-6,
        open=(windows.open - now).float(),
        close=torch.where(windows.mask, closes, -torch.inf).float(),
        bit=bit,
        members=of_site.sum(2),
        earlier=of_site.tril().sum(2),
        same=same.float(),
        leads=same.float().argmax(2) == torch.arange(images, device=site.device),
        worth=value.unsqueeze(-1) * expected_worth(scenario, look_up(clear, site), size.float(), done.float()),
    )


class Track(NamedTuple):
    """Orbits of N satellites, as circles about the Earth; Earth-fixed axes, 1,000 km.

    Attributes:
        position: Position now, [N, 3].
        ahead: Position after a quarter of an orbit about an Earth that does not rotate, [N, 3].
        rate: Angular rate, rad/s, [N].
    """

    position: Tensor
    ahead: Tensor
    rate: Tensor

    @classmethod
    def of(cls, satellite: BoundAccessSatellite) -> Track:
        """Return the current orbits."""
        r, v = satellite.dynamics.r_BN_P, satellite.dynamics.v_BN_P
        turning = torch.stack([-r[:, 1], r[:, 0], torch.zeros_like(r[:, 0])], 1) * EARTH_ROTATION_RATE
        v_N, distance = v + turning, r.norm(dim=1, keepdim=True)
        speed = v_N.norm(dim=1, keepdim=True)
        return cls((r * 1e-6).float(), (v_N / speed * distance * 1e-6).float(), (speed / distance).squeeze(1).float())

    def at(self, time: Tensor) -> Tensor:
        """Return positions after the times [N, B] s, [N, B, 3]."""
        angle, turned = self.rate.unsqueeze(1) * time, EARTH_ROTATION_RATE * time
        r_N = self.position.unsqueeze(1) * angle.cos().unsqueeze(2) + self.ahead.unsqueeze(1) * angle.sin().unsqueeze(2)
        x, y, z = r_N.unbind(2)
        return torch.stack([turned.cos() * x + turned.sin() * y, turned.cos() * y - turned.sin() * x, z], 2)


def turn_times(position: Tensor, aim: Tensor, place: Tensor) -> Tensor:
    """Return the times of turns, s, [N, B, K].

    Args:
        position: Positions of satellites, 1,000 km, [N, B, 3].
        aim: Unit vectors along their instruments, [N, B, 3].
        place: Places to image, 1,000 km, [N, K, 3].
    """
    square = along = torch.zeros((), dtype=torch.float32)
    for k in range(3):  # not by matrices, whose products depend on the size of the batch
        rho = place[..., k].unsqueeze(1) - position[..., k].unsqueeze(2)
        square, along = square + rho * rho, along + rho * aim[..., k].unsqueeze(2)
    chord = (2.0 - 2.0 * along * square.rsqrt()).clamp(min=0.0).sqrt()
    return (TURN[0] + TURN[1] * chord.sqrt()).clamp(min=1.0)


class Beam(NamedTuple):
    """Sequences of images, B for each of N satellites.

    Attributes:
        time: Time until the last image, s, [N, B].
        aim: Unit vector along the instrument then, [N, B, 3].
        taken: Sum of the bits of the images of the site of each image that are in the sequence, [N, B, K].
        paid: What they pay on average, divided by e per patience, [N, B]; minus infinity for copies of others.
        first: First image, [N, B].
        code: Number of the set of images, [N, B].
    """

    time: Tensor
    aim: Tensor
    taken: Tensor
    paid: Tensor
    first: Tensor
    code: Tensor


@dataclass
class Schedule:
    """Takes the first image of the best sequence that a beam search finds.

    Attributes:
        env: The environment.
        width: Number of sequences kept for each satellite.
        depth: Number of images of a sequence, at most.
        images: Number of images from which sequences are chosen, those whose windows close next.
        horizon: Time after which sequences are not continued, s.
        flown: Number of first images tried in copies of the episode, which tell how long the turn takes; 0 for none.
        judgment: Numbers by which sequences are judged.
        copies: The environment of the copies.
    """

    env: SatelliteTasking
    width: int
    depth: int
    images: int
    horizon: float
    flown: int
    judgment: Judgment
    copies: SatelliteTasking | None = None

    @torch.no_grad()
    def decide(self, action_mask: Tensor, done: Tensor) -> Tensor:
        """Return actions, [N], for the legal ones [N, A] in the current episodes, of which those ``done`` [N, 1] have ended."""
        satellite, actions = cast(BoundImagingSatellite, self.env.satellite), image_actions(self.env)
        ahead, track = look_ahead(satellite, self.images), Track.of(satellite)
        legal = torch.nn.functional.pad(action_mask[:, actions.start : actions.stop], (0, self.images - len(actions)))
        zero = torch.zeros(len(legal), 1, dtype=torch.float32, device=legal.device)
        none = zero.long()
        taken = none.unsqueeze(2).expand(-1, -1, self.images)
        beam = Beam(zero, satellite.fsw.c_hat_P.float().unsqueeze(1), taken, zero, none, none)
        for step in range(self.depth):
            longer = self._longer(beam, ahead, track, None if step else legal)
            width = self.flown if self.flown and not step else self.width
            worth = longer.paid + _together(self._hope(longer, ahead)[0])
            order = worth.topk(min(width, worth.shape[1]), 1).indices
            beam = Beam(*(_rows(x, order) for x in longer))
            if self.flown and not step:
                beam = self._fly(beam, actions.start + beam.first, ~done)
        worth = beam.paid + _together(self._hope(beam, ahead)[0])
        return actions.start + beam.first.gather(1, worth.argmax(1, keepdim=True)).squeeze(1)

    def _fly(self, beam: Beam, action: Tensor, playing: Tensor) -> Beam:
        """Return sequences of one image as they are flown: with the time of the image, and without those that fail."""
        n, width = action.shape
        if self.copies is None or self.copies.num_envs != n * width:
            self.copies = self.env.like(n * width)
        copies, places = self.copies, torch.arange(n * width, device=action.device)
        copies.restore(self.env, places, places // width)
        satellite = cast(BoundImagingSatellite, copies.satellite)
        start, before = copies.fleet.sim_time, satellite.imaged
        now = copies.observe().set("action", action.flatten()).set("_step", playing.expand(-1, width).flatten())
        copies.step(now)
        time = (copies.fleet.sim_time - start).float().view(n, width)
        taken = (satellite.imaged > before).view(n, width)
        discount = torch.exp((beam.time - time) / self.judgment.patience)
        paid = torch.where(taken, beam.paid * discount, -1e6 - time)
        return beam._replace(time=time, aim=satellite.fsw.c_hat_P.float().view(n, width, 3), paid=paid)

    def _hope(self, beam: Beam, ahead: Ahead) -> tuple[Tensor, Tensor]:
        """Return what the rest of the site of each image is worth, if begun, and its images in reach, [N, B, K] each."""
        left, bit, time = ahead.members.unsqueeze(1) & ~beam.taken, ahead.bit.unsqueeze(1), beam.time.unsqueeze(2)
        last = time + self.judgment.each * _number(left & ahead.earlier.unsqueeze(1))
        late = (last > ahead.close.unsqueeze(1)) & (left & bit > 0)
        reach = left & ~((late * bit).float() @ ahead.same).long()
        rest = self._worth(ahead, beam.taken | reach) - self._worth(ahead, beam.taken)
        last = torch.maximum(time, ahead.open.unsqueeze(1)) + self.judgment.each * _number(reach)
        hope = rest * torch.exp(-last / self.judgment.patience)
        return torch.where(ahead.leads.unsqueeze(1), hope, 0.0), reach

    @staticmethod
    def _worth(ahead: Ahead, taken: Tensor) -> Tensor:
        k = taken.shape[2]
        index = taken + torch.arange(0, 64 * k, 64, device=taken.device)
        return ahead.worth.flatten(1).gather(1, index.flatten(1)).view_as(index)

    def _longer(self, beam: Beam, ahead: Ahead, track: Track, legal: Tensor | None) -> Beam:
        """Return the best sequences of one more image, those ``legal`` [N, K] if it is the first, and those that end."""
        patience, each, reserve = self.judgment
        _, width, k = beam.taken.shape
        turned = beam.time.unsqueeze(2) + turn_times(track.at(beam.time), beam.aim, ahead.place)
        time = torch.maximum(turned, ahead.open.unsqueeze(1) + AFTER_OPENING)
        bit, discount = ahead.bit.unsqueeze(1), torch.exp(-time / patience)
        hope, reach = self._hope(beam, ahead)
        most, sites = hope.topk(3, 2)
        same = [_rows(ahead.same, sites[..., i]) > 0 for i in range(2)]
        h = [most[..., i, None] for i in range(3)]
        wait = torch.exp((beam.time.unsqueeze(2) - time) / patience)
        first, second = (
            torch.where(same[0], h[1], h[0]) * wait,
            torch.where(same[0] | same[1], h[2], h[1]) * wait,
        )  # of other sites
        new, rest = beam.taken | bit, reach & ~bit
        after = self._worth(ahead, new)
        own = (self._worth(ahead, new | rest) - after) * discount * torch.exp(-_number(rest) * (each / patience))
        paid = beam.paid.unsqueeze(2) + (after - self._worth(ahead, beam.taken)) * discount
        possible = (time + reserve < ahead.close.unsqueeze(1)) & (beam.taken & bit == 0)
        if legal is None:
            paid = paid.masked_fill(~possible | (beam.time > self.horizon).unsqueeze(2), -torch.inf)
            ends = torch.where(torch.isinf(paid).all(2), beam.paid + _together(hope), -torch.inf).unsqueeze(2)
        else:  # none in time: the soonest
            paid = torch.where(possible, paid, -1e6 - time).masked_fill(~legal.unsqueeze(1), -torch.inf)
            ends = torch.full_like(paid[..., :1], -torch.inf)
        hopes = torch.maximum(first, own) + NEXT_BEST * torch.maximum(torch.minimum(first, own), second)
        score = torch.cat([paid + hopes, ends], 2)
        best, index = score.flatten(1).topk(min(2 * self.width, width * (k + 1)), 1)
        parent, image = index // (k + 1), index % (k + 1)
        stays, image = image == k, image.clamp(max=k - 1)
        code = beam.code.gather(1, parent) + torch.where(stays, 0, (image + 1) * 2654435761 % 4294967291 * (image + 7919))
        key = code * 256 + torch.where(stays, k, image)
        twice = (key.unsqueeze(2) == key.unsqueeze(1)).tril(-1).any(2)
        flat = parent * k + image
        moment = torch.where(stays, beam.time.gather(1, parent), time.flatten(1).gather(1, flat))
        line = _rows(ahead.place, image) - track.at(moment)
        aim = torch.where(stays.unsqueeze(2), _rows(beam.aim, parent), line / line.norm(dim=2, keepdim=True))
        chosen = torch.where(_rows(ahead.same, image) > 0, ahead.bit.gather(1, image).unsqueeze(2), 0)
        taken = _rows(beam.taken, parent) | chosen.masked_fill(stays.unsqueeze(2), 0)
        pays = torch.where(stays, beam.paid.gather(1, parent), paid.flatten(1).gather(1, flat))
        pays = pays.masked_fill(twice | torch.isinf(best), -torch.inf)
        return Beam(moment, aim, taken, pays, beam.first.gather(1, parent) if legal is None else image, code)


NEXT_BEST = 0.5
"""Weight of the second best site."""


def _together(hope: Tensor) -> Tensor:
    """Return what the best two sites are worth, [N, B]."""
    best = hope.topk(2, 2).values
    return best[..., 0] + NEXT_BEST * best[..., 1]


def _rows(table: Tensor, index: Tensor) -> Tensor:
    """Return the rows [N, B, ...] of a table [N, M, ...] with the indices [N, B]."""
    if table.ndim == 2:
        return table.gather(1, index)
    n, m = table.shape[:2]
    flat = index + m * torch.arange(n, device=index.device).unsqueeze(1)
    return table.flatten(0, 1).index_select(0, flat.flatten()).unflatten(0, (n, -1))


NUMBER = torch.tensor([bin(k).count("1") for k in range(64)], dtype=torch.float32)


def _number(sets: Tensor) -> Tensor:
    """Return the number of images of sets."""
    return NUMBER.to(sets.device).index_select(0, sets.flatten()).view_as(sets)


def schedule(
    env: SatelliteTasking,
    seed: int = 0,
    *,
    width: int = 8,
    depth: int = 14,
    images: int = 64,
    horizon: float = 240.0,
    flown: int = 4,
    **numbers: float,
) -> TensorDictModule:
    """Return a :class:`Schedule` for an environment like Sites-v1, in whose current episodes it decides.

    Args:
        env: The environment.
        seed: Not used.
        width: Number of sequences kept.
        depth: Number of images of a sequence, at most.
        images: Number of images from which sequences are chosen, at least those observed.
        horizon: Time after which sequences are not continued, s.
        flown: Number of first images flown in copies; 0 for none.
        **numbers: Numbers of :class:`Judgment` that replace the defaults.
    """
    rule = Schedule(env, width, depth, images, horizon, flown, Judgment(**numbers))
    return TensorDictModule(rule.decide, in_keys=["action_mask", "done"], out_keys=["action"])
