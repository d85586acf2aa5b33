"""Who decides for which satellites, and which agents share tensors."""

import pytest
import torch

from bsk_torch.env.agents import ROOT, Group, agents_of, check_map, make_groups, named
from bsk_torch.sim.names import snake

NAMES = ["A", "B", "C", "D", "E"]
TYPES = [[0, 3], [1, 2, 4]]
TITLES = ["WideImager", "Relay"]
AGENTS = {name: [name] for name in NAMES}


def groups(agents=None, types=None, group_map=None) -> dict[str, Group]:
    return {g.name: g for g in make_groups(agents or AGENTS, NAMES, types or TYPES, TITLES, group_map)}


@pytest.mark.parametrize("nothing", [None, {}])
def test_every_satellite_is_an_agent_unless_others_decide_for_it(nothing):
    assert agents_of(NAMES, nothing) == AGENTS


def test_agents_of_several_satellites_come_first():
    agents = agents_of(NAMES, {"Crew": ("D", "A"), "Solo": ["C"]})
    assert list(agents.items()) == [("Crew", ["D", "A"]), ("Solo", ["C"]), ("B", ["B"]), ("E", ["E"])]
    assert agents_of(["A", "B"], {"A": ["B", "A"]}) == {"A": ["B", "A"]}


def test_groups_by_type_and_by_the_order_of_members():
    (group,) = groups(types=[[0, 1, 2, 3, 4]]).values()
    assert (group.name, group.agents, group.types, group.whole) == ("agents", tuple(NAMES), (0,), (True,))
    assert (group.members.tolist(), group.within[0].tolist()) == ([[0], [1], [2], [3], [4]], [0, 1, 2, 3, 4])
    assert not group.is_meta
    found = groups()
    assert list(found) == ["wide_imager", "relay"]
    assert [group.agents for group in found.values()] == [("A", "D"), ("B", "C", "E")]
    assert [group.members.flatten().tolist() for group in found.values()] == TYPES
    assert [group.within[0].tolist() for group in found.values()] == [[0, 1], [0, 1, 2]]
    assert all(group.whole == (True,) for group in found.values())
    found = groups(agents_of(NAMES, {"One": ["A", "B"], "Two": ["C", "D"]}))
    assert list(found) == ["wide_imager_and_relay", "relay_and_wide_imager", "relay"]
    group = groups()["relay"].to(torch.device("meta"))
    assert group.members.is_meta
    assert group.within[0].is_meta
    assert group.agents == ("B", "C", "E")


def test_groups_of_agents_that_decide_for_several_and_of_the_user():
    """Agents are alike where their members are of the same types in the same order; satellites that are left are apart."""
    found = groups(agents_of(NAMES, {"One": ["E", "A"], "Two": ["B", "D"]}))
    assert {name: group.agents for name, group in found.items()} == {"relay_and_wide_imager": ("One", "Two"), "relay": ("C",)}
    meta, alone = found.values()
    assert meta.is_meta
    assert (meta.members.tolist(), meta.types) == ([[4, 0], [1, 3]], (1, 0))
    assert [index.tolist() for index in meta.within] == [[2, 0], [0, 1]]
    assert meta.whole == (False, True)
    assert (alone.members.tolist(), alone.within[0].tolist(), alone.whole) == ([[2]], [1], (False,))
    found = groups(group_map={"near": ["E", "B"], "far": ["C"], "eyes": ["D", "A"]})
    assert {name: group.members.flatten().tolist() for name, group in found.items()} == {
        "near": [4, 1],
        "far": [2],
        "eyes": [3, 0],
    }
    assert [group.within[0].tolist() for group in found.values()] == [[2, 0], [1], [1, 0]]
    assert not any(group.whole[0] for group in found.values())


def test_members_find_their_satellites():
    """``columns[type][within]`` are the members, whatever the agents."""
    for agents in (AGENTS, agents_of(NAMES, {"One": ["E", "A", "C"]}), agents_of(NAMES, {"One": ["A", "D"]})):
        made = groups(agents)
        assert made
        for group in made.values():
            assert len(group.types)
            for m, (t, within) in enumerate(zip(group.types, group.within, strict=True)):
                assert torch.equal(torch.tensor(TYPES[t])[within], group.members[:, m])
                assert group.whole[m] == (group.members[:, m].tolist() == TYPES[t])
                assert [NAMES[k] for k in group.members[:, m].tolist()] == [agents[agent][m] for agent in group.agents]


@pytest.mark.parametrize(
    ("title", "name"), [("Imager", "imager"), ("WideImager", "wide_imager"), ("Relay2B", "relay2_b"), ("wide", "wide")]
)
def test_snake(title, name):
    assert snake(title) == name


def test_names_of_groups_differ_and_hide_nothing():
    kinds = {(0,): ["A"], (1,): ["B"], (2,): ["C"], (0, 1): ["D"]}
    assert named(kinds, ["Imager", "Imager", "Imager_2"]) == {
        "imager": ["A"],
        "imager_2": ["B"],
        "imager_2_2": ["C"],
        "imager_and_imager": ["D"],
    }
    assert list(named({(0,): ["A"], (1,): ["B"]}, ["Reward", "Done"])) == ["reward_2", "done_2"]
    signature = {"A": (0,), "B": (0,), "C": (1, 0)}
    check_map({"one": ["B", "A"], "two": ["C"]}, signature)
    check_map({"one": ["B"], "agents": ["A"], "two": ["C"]}, signature)
    assert "agents" not in ROOT
