"""Recordings for tests of the viewer, made by formulas: circular orbits, attitudes that face the Earth, invented decisions."""

import numpy as np

from bsk_torch.recording.recording import Array, Branch, Craft, Death, Instrument, Recording, Scene, Series, Track

MU = 3.986004418e14
RADIUS = 7.0e6
RATE = 7.2921159e-5
ANGLE0 = 0.5
"""Angle of the Earth at time 0, rad."""

ACTIONS = ["charge", "downlink", "image"]
SUN_N = np.array([1.0, 0.0, 0.0])
SCRIPT = "<script>window.hacked = 1</script>"
"""A name that must stay text."""


def states(satellite: int, times: Array) -> tuple[Array, Array]:
    """Position, m, and velocity, m/s, of a satellite on its circular orbit, [K, 3] each."""
    node, inclination, rate = 0.6 * satellite, 0.9, np.sqrt(MU / RADIUS**3)
    angle = rate * times + 0.4 * satellite
    along = np.array([np.cos(node), np.sin(node), 0.0])
    across = np.array([-np.sin(node) * np.cos(inclination), np.cos(node) * np.cos(inclination), np.sin(inclination)])
    r_N = RADIUS * (np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * across)
    return r_N, RADIUS * rate * (np.cos(angle)[:, None] * across - np.sin(angle)[:, None] * along)


def nadir_dcm(r_N: Array, v_N: Array) -> Array:
    """DCM [M, 3, 3] from N to a body whose third axis points to the center of the Earth, and the first roughly ahead."""
    down = -r_N / np.linalg.norm(r_N, axis=-1, keepdims=True)
    side = np.cross(down, v_N)
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    return np.stack([np.cross(side, down), side, down], axis=-2)


def dcm_to_mrp(BN: Array) -> Array:
    """Modified Rodrigues parameters [M, 3], of norm at most 1, by Euler parameters after Shepperd."""
    trace = np.trace(BN, axis1=-2, axis2=-1)
    diagonal = np.diagonal(BN, axis1=-2, axis2=-1)
    squares = np.concatenate([(1.0 + trace)[:, None], 1.0 + 2.0 * diagonal - trace[:, None]], -1) / 4.0
    largest = squares.argmax(-1)
    differences = np.stack([BN[:, 1, 2] - BN[:, 2, 1], BN[:, 2, 0] - BN[:, 0, 2], BN[:, 0, 1] - BN[:, 1, 0]], -1) / 4.0
    sums = (BN + np.swapaxes(BN, -1, -2)) / 4.0
    products = np.zeros((len(BN), 4, 4))
    products[:, 0, 1:] = products[:, 1:, 0] = differences
    products[:, 1:, 1:] = sums
    products[:, range(4), range(4)] = squares
    row = products[np.arange(len(BN)), largest]
    beta = row / np.sqrt(row[np.arange(len(BN)), largest])[:, None]
    beta *= np.where(beta[:, :1] < 0.0, -1.0, 1.0)
    return beta[:, 1:] / (1.0 + beta[:, :1])


def ground_targets(count: int) -> Array:
    """Places [T, 3] on a sphere of the Earth's radius, spread evenly."""
    k = np.arange(count) + 0.5
    z, longitude = 1.0 - 2.0 * k / max(count, 1), np.pi * (1.0 + np.sqrt(5.0)) * k
    return 6.371e6 * np.stack([np.sqrt(1.0 - z**2) * np.cos(longitude), np.sqrt(1.0 - z**2) * np.sin(longitude), z], -1)


def track_arrays(satellites: int, targets: int, duration: float, shift: int = 0) -> dict[str, Array]:
    """Arrays of a track with a decision of every satellite each 300 s; ``shift`` changes which."""
    key_times = np.arange(0.0, duration + 1.0, 60.0)
    orbits = [states(k, key_times) for k in range(satellites)]
    ticks = np.arange(0.0, duration + 0.5)
    sigma = np.stack([dcm_to_mrp(nadir_dcm(*states(k, ticks))) for k in range(satellites)], 1)
    series_times = np.arange(0.0, duration + 1.0, 10.0)
    battery = 0.6 + 0.4 * np.cos(2.0 * np.pi * series_times / 5800.0)
    storage = series_times / duration
    series = np.stack([np.stack([battery, storage], -1)] * satellites, 1)
    start = np.repeat(np.arange(0.0, duration, 300.0), satellites)
    who = np.tile(np.arange(satellites), len(start) // satellites)
    action = (np.arange(len(start)) + shift) % len(ACTIONS)
    mask = np.ones((len(start), len(ACTIONS)), "u1")
    mask[1::4, 1] = 0
    probability = np.where(np.arange(3) == action[:, None], 0.8, 0.1)
    images = np.flatnonzero(action == 2)
    target = np.where(action == 2, np.arange(len(start)) % max(targets, 1), -1) if targets else np.full(len(start), -1)
    pairs = min(satellites - 1, 3)
    return {
        "key_times": key_times,
        "r_N": np.stack([r for r, _ in orbits], 1),
        "v_N": np.stack([v for _, v in orbits], 1),
        "sun_N": np.tile(SUN_N, (len(key_times), 1)),
        "sigma": sigma,
        "series_times": series_times,
        "series": series,
        "decision_time": start,
        "decision_end": np.minimum(start + 300.0, duration),
        "decision_satellite": who,
        "decision_action": action,
        "decision_target": target,
        "decision_reward": np.where(action == 2, 0.1, 0.0),
        "decision_mask": mask,
        "decision_probability": probability,
        "decision_action_value": np.full((len(start), len(ACTIONS)), np.nan),
        "observation": np.linspace(0.0, 1.0, 2 * len(start)).reshape(-1, 2),
        "event_time": start[images] + 200.0 if targets else np.zeros(0),
        "event_satellite": who[images] if targets else np.zeros(0),
        "event_target": target[images] if targets else np.zeros(0),
        "event_kind": np.arange(len(images)) % 3 if targets else np.zeros(0),
        "link_start": np.full(pairs, 0.2 * duration),
        "link_end": np.full(pairs, 0.6 * duration),
        "link_a": np.arange(pairs),
        "link_b": np.arange(pairs) + 1,
        "passes": np.array([[0.1 * duration, 0.2 * duration]]),
        "passes_satellite": np.zeros(1),
        "eclipses": np.array([[0.3 * duration, 0.6 * duration]]),
        "eclipses_satellite": np.zeros(1),
    }


def flight(label: str, satellites: int, targets: int, duration: float, **others: object) -> Track:
    """A track whose first satellite dies at the end of a branch."""
    branch = others.get("branch")
    return Track(
        label=label,
        scene=0,
        total=1.5 if branch is None else 0.7,
        duration=duration,
        limit=duration,
        deaths=[] if branch is None else [Death(satellite=0, time=duration, causes=["battery"])],
        series=[Series(name="battery", label="battery", bad="low"), Series(name="storage", label="data buffer", bad="high")],
        counts={"imaged": 3},
        attitude_start=0.0,
        attitude_step=1.0,
        arrays=track_arrays(satellites, targets, duration, 0 if branch is None else 1),
        **others,  # type: ignore[arg-type]
    )


def synthetic_recording(
    satellites: int = 2, targets: int = 40, duration: float = 3000.0, tracks: int = 2, name: str = "Sat"
) -> Recording:
    """A recording of ``tracks`` flights, of which all but the first are branches; satellites are called ``name`` and a number."""
    cos, sin = np.cos(ANGLE0), np.sin(ANGLE0)
    scene = Scene(
        seed=0,
        et=6.6e8,
        PN0=[cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0],
        rate=RATE,
        station_names=["Station A", "Station B"],
        arrays={
            "stations_P": np.array([[6.371e6, 0.0, 0.0], [0.0, 6.371e6, 0.0]]),
            "targets_P": ground_targets(targets),
            "priority": np.linspace(0.0, 1.0, targets),
            "cloud": np.linspace(0.0, 1.0, targets),
        },
    )
    crafts = [
        Craft(
            name=f"{name}{k}",
            kind="Imager",
            actions=ACTIONS,
            observation=["battery_charge_fraction", "storage_level_fraction"],
            instrument=Instrument(axis_B=[0.0, 0.0, 1.0], half_angle=0.1),
            panel_normal_B=[0.0, -1.0, 0.0],
        )
        for k in range(satellites)
    ]
    others = [Branch(time=600.0, decision=2 * satellites, satellite=0, action=1)] * (tracks - 1)
    flights = [flight("seed 0", satellites, targets, duration)]
    flights += [flight(f"branch {k}", satellites, targets, duration, parent=0, branch=branch) for k, branch in enumerate(others)]
    return Recording(
        title="A synthetic flight",
        preset="Synthetic-v1",
        policy="rule",
        package="0",
        places="ground" if targets else "none",
        station_min_elevation=0.17,
        satellites=crafts,
        scenes=[scene],
        tracks=flights,
    )
