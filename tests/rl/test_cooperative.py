"""The rule for clusters, on observations made by hand."""

import pytest
import torch
from tensordict import TensorDict

from bsk_torch import obs
from bsk_torch.obs.base import ObservationBuilder
from bsk_torch.rl.rules.cooperative import CooperativeRule, Sharing
from bsk_torch.rl.rules.imaging import by_tour
from bsk_torch.rl.rules.targets import TargetReader

ENTRIES = [dict(prop="priority"), dict(prop="r_LB_H", norm=800e3), dict(prop="target_angle"), dict(prop="opportunity_open"),
           dict(prop="opportunity_close")]  # fmt: skip
ENTRIES += [dict(fn=lambda satellite, targets: None, name=name, prop=name) for name in ("cloud_forecast", "claimed")]
ACTIONS = ["action_charge", "action_downlink", "action_desat", "action_image_0", "action_image_1", "action_image_2"]
CLEAR, CLOUDY, CLAIMED, LATE = [0.4, 0.1, 0.0], [0.5, 1.0, 0.0], [0.9, 0.0, 1.0], [1.0, 0.0, 0.0]
"""Priorities, forecasts and claims of targets; the last one closes too early."""


def decide(*targets, sees_through=False, battery=0.9, level=0.1, opens=1.0, eclipse=(0.5, 0.8), legal=ACTIONS, vector=False):
    """The action that the rule takes with three targets, the last of which exists only if it is given."""
    given = [*targets, *[targets[-1]] * (3 - len(targets))]
    rows = [
        [p, 0.0, 0.1 * k, 1.0, 0.1, 0.0, 5.0 if (p, f, c) == tuple(LATE) else 100.0, f, c] for k, (p, f, c) in enumerate(given)
    ]
    mask = [1.0] * len(targets) + [0.0] * (3 - len(targets))
    values = {
        "sat_props": {"battery_charge_fraction": torch.tensor([battery]), "storage_level_fraction": torch.tensor([level])},
        "target": {"rows": torch.tensor([rows]), "mask": torch.tensor([mask])},
        "ground_station": {"ground_station_0": {"opportunity_open_normd": torch.tensor([opens])}},
        "eclipse": torch.tensor([list(eclipse)]),
    }
    description = ObservationBuilder.describe(values)
    see = TargetReader(obs.OpportunityProperties(*ENTRIES, n_ahead_observe=3, as_set=True), description)
    rule = CooperativeRule(see, range(3, 6), by_tour, description, ACTIONS, sees_through)
    observation = ObservationBuilder.vector(values, torch.float32) if vector else TensorDict(values, [1])
    action, _ = rule.decide(observation, torch.tensor([[name in legal for name in ACTIONS]]))
    return ACTIONS[int(action)]


@pytest.mark.parametrize("vector", [False, True])
def test_optical_satellites_take_clear_targets_and_the_radar_cloudy_ones(vector):
    assert decide(CLEAR, CLOUDY, CLAIMED, vector=vector) == "action_image_0"
    assert decide(CLEAR, CLOUDY, CLAIMED, sees_through=True, vector=vector) == "action_image_1"


def test_the_radar_takes_clear_targets_that_are_worth_more_if_they_are_legal():
    assert decide([0.9, 0.1, 0.0], [0.4, 1.0, 0.0], CLAIMED, sees_through=True) == "action_image_0"
    assert decide(CLEAR, legal=["action_desat"]) == "action_desat"
    assert decide(CLEAR, CLOUDY, sees_through=True, legal=["action_charge", "action_image_0"]) == "action_image_0"


def test_charging_is_better_than_nothing_and_competes_with_images_in_sunlight_only():
    assert decide(CLOUDY, CLAIMED, LATE) == "action_charge"
    assert (decide(CLOUDY, CLAIMED, LATE, battery=1.0), decide(CLAIMED)) == ("action_charge", "action_charge")
    faint = [0.1, 0.0, 0.0]
    assert (decide(faint, battery=0.3), decide(faint, battery=0.95)) == ("action_charge", "action_image_0")
    assert decide(faint, battery=0.3, eclipse=(0.9, 0.2)) == "action_image_0"


@pytest.mark.parametrize(
    ("level", "opens", "expected"),
    [(0.6, -0.1, "action_downlink"), (0.6, 0.1, "action_image_0"), (0.4, -0.1, "action_image_0")],
)
def test_passes_are_used_with_a_store_that_is_half_full(level, opens, expected):
    assert (Sharing().full, decide(CLEAR, level=level, opens=opens)) == (0.5, expected)
