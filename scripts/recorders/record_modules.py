"""Record Basilisk's modules, each run alone on random inputs, as small tables that unit tests compare with.

Usage::

    python scripts/recorders/record_modules.py                 # every table, into tests/sim/data
    python scripts/recorders/record_modules.py store           # only this one

Needs the extra ``basilisk`` (bsk==2.12.1), but none of its support data. Inputs are drawn from the seeds below, written as
messages before every tick, and stored next to what the modules answered; a repetition gives the same arrays.

``store.npz``
    simpleInstrument, spaceToGroundTransmitter and partitionedStorageUnit in the order in which bsk_rl runs them. For each group
    of cases (``hundredth``: three named partitions and STORED DATA at ticks of 0.01 s, ``second``: the same at 1 s, ``single``:
    one partition at 1 s) the ``parameters`` of each case (columns ``PARAMETERS``), what was set before each tick (``inputs``
    [T, cases, 4], columns ``INPUTS``) and what came of it: ``levels`` [T, cases, partitions] bit, and the transmitter's
    ``rate`` [T, cases] bit/s.
``steering.npz``
    mrpSteering and rateServoFullNonlinear: torques that are asked of the body under random errors, with pauses.
``controller.npz``
    simpleInstrumentController: commands under random errors, access and tasks.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import mrpSteering, rateServoFullNonlinear, simpleInstrumentController
from Basilisk.simulation import partitionedStorageUnit, simpleInstrument, spaceToGroundTransmitter
from Basilisk.utilities import SimulationBaseClass

Array = np.ndarray[Any, Any]

PARAMETERS = ("image", "transmitter rate", "packet size", "capacity", "initial level")
INPUTS = ("instrument command", "partition", "transmitter on", "access")


class Clock:
    """A simulation of modules that run in the given order, one tick at a time."""

    def __init__(self, h_ns: int, modules: list[Any], enabled: bool = True) -> None:
        """Start at time zero, where the modules run once if they are ``enabled``."""
        self.simulation, self.h_ns, self.now = SimulationBaseClass.SimBaseClass(), h_ns, 0
        self.simulation.CreateNewProcess("process").addTask(self.simulation.CreateNewTask("task", h_ns))
        for priority, module in enumerate(reversed(modules), 1):
            self.simulation.AddModelToTask("task", module, priority)
        self._switch(enabled)
        self.simulation.InitializeSimulation()
        self._run()

    def tick(self, enabled: bool = True) -> None:
        """Advance by one tick, in which the modules run if they are ``enabled``."""
        self._switch(enabled)
        self.now += self.h_ns
        self._run()

    def _switch(self, enabled: bool) -> None:
        (self.simulation.enableTask if enabled else self.simulation.disableTask)("task")

    def _run(self) -> None:
        self.simulation.ConfigureStopTime(self.now)
        self.simulation.ExecuteSimulation()


def held(rng: np.random.Generator, ticks: int, change: float, draw: Callable[[], float]) -> Array:
    """Values [ticks] that stay for a while: each tick draws a new one with probability ``change``."""
    values = [draw()]
    for _ in range(ticks - 1):
        values.append(draw() if rng.random() < change else values[-1])
    return np.array(values)


# -- store -------------------------------------------------------------------------------------------------------------------


class Group(NamedTuple):
    """Cases that share a tick and partitions; ``parameters`` as in ``PARAMETERS``."""

    h_ns: int
    ticks: int
    partitions: int
    parameters: list[tuple[float, ...]]


IMAGE = 8e6
CASES = [
    (IMAGE, -8e6, -IMAGE, 20 * IMAGE, 0.0),  # bsk_rl's defaults: a packet a second
    (IMAGE, -3e6, -IMAGE, 6 * IMAGE, 3.0 * IMAGE),
    (IMAGE, -4e6, -IMAGE, 6 * IMAGE, 6.0 * IMAGE),  # full from the start
    (IMAGE, -24e6, -IMAGE, 10 * IMAGE, 2.5 * IMAGE),
    (IMAGE, -5e6, -1.0, 8 * IMAGE, 1.0),
    (IMAGE / 4.0, -2.5e6, 0.0, 4 * IMAGE, 12.0),
    (IMAGE / 4.0, -1.1e6, -IMAGE / 4.0, IMAGE, 5.0),  # two ticks for an image, and little room: partitions run dry
    (1234567.5, -1357911.5, -2.0 * 1234567.5, 12345678.0, 7654321.0),
    (17.25, -4.5, -10.0, 60.0, 80.0),  # more than fits
]
GROUPS = {
    "second": Group(1_000_000_000, 150, 3, CASES),
    "hundredth": Group(10_000_000, 150, 3, [(image, 100.0 * rate, *rest) for image, rate, *rest in CASES]),
    "single": Group(1_000_000_000, 100, 1, [(*case[:4], 0.0) for case in CASES]),
}


class Store:
    """Instrument, transmitter and store of one case; the instrument takes an image in a tick."""

    def __init__(self, h_ns: int, names: list[str], parameters: tuple[float, ...]) -> None:
        """Connect the modules as bsk_rl does."""
        image, baud, packet, capacity, level = parameters
        self.names = names
        self.instrument, self.store = simpleInstrument.SimpleInstrument(), partitionedStorageUnit.PartitionedStorageUnit()
        self.transmitter = spaceToGroundTransmitter.SpaceToGroundTransmitter()
        self.instrument.nodeBaudRate, self.instrument.nodeDataName = image / (h_ns * 1e-9), names[0]
        self.transmitter.nodeBaudRate, self.transmitter.packetSize, self.transmitter.numBuffers = baud, packet, len(names)
        self.store.storageCapacity = int(capacity)
        self.store.addDataNodeToModel(self.instrument.nodeDataOutMsg)
        self.store.addDataNodeToModel(self.transmitter.nodeDataOutMsg)
        for name in names:
            self.store.addPartition(name)
        if level:
            self.store.setDataBuffer(["STORED DATA"], [int(level)])
        self.command, self.access = messaging.DeviceCmdMsg(), messaging.AccessMsg()
        self.instrument.nodeStatusInMsg.subscribeTo(self.command)
        self.transmitter.addAccessMsgToTransmitter(self.access)
        self.transmitter.addStorageUnitToTransmitter(self.store.storageUnitDataOutMsg)
        self.transmitter.dataStatus = 0
        self.clock = Clock(h_ns, [self.instrument, self.transmitter, self.store])

    def tick(self, command: float, partition: float, on: float, access: float) -> tuple[list[float], float]:
        """Levels of the partitions, and the transmitter's rate, after a tick with these inputs."""
        now = self.clock.now
        self.instrument.nodeDataName, self.transmitter.dataStatus = self.names[int(partition)], int(on)
        self.command.write(messaging.DeviceCmdMsgPayload(deviceCmd=int(command)), now)
        self.access.write(messaging.AccessMsgPayload(hasAccess=int(access)), now)
        self.clock.tick()
        levels = self.store.storageUnitDataOutMsg.read().storedData
        return list(levels), self.transmitter.nodeDataOutMsg.read().baudRate


def store_inputs(rng: np.random.Generator, group: Group) -> Array:
    """Inputs [T, 4] of a case: rare images, long downlinks, passes that begin and end while they last."""
    coin = lambda share: lambda: float(rng.random() < share)
    columns = (
        held(rng, group.ticks, 0.6, coin(0.3)),
        held(rng, group.ticks, 0.7, lambda: float(rng.integers(group.partitions))),
        held(rng, group.ticks, 0.15, coin(0.75)),
        held(rng, group.ticks, 0.2, coin(0.75)),
    )
    return np.stack(columns, -1)


def record_group(name: str, group: Group) -> dict[str, Array]:
    """Arrays of one group of cases."""
    rng = np.random.default_rng(sum(name.encode()))
    names = [f"buffer {k}" for k in range(group.partitions)]
    width = group.partitions + (group.partitions > 1)
    inputs = np.stack([store_inputs(rng, group) for _ in group.parameters], 1)
    levels, rates = np.zeros((*inputs.shape[:2], width), dtype=np.int64), np.zeros(inputs.shape[:2])
    for case, parameters in enumerate(group.parameters):
        store = Store(group.h_ns, names, parameters)
        for k in range(group.ticks):
            found, rates[k, case] = store.tick(*inputs[k, case])
            levels[k, case, : len(found)] = found  # what does not fit at first has no partition
    fixed = {"h_ns": np.array(group.h_ns), "parameters": np.array(group.parameters)}
    return {**fixed, "inputs": inputs.astype(np.int8), "levels": levels, "rate": rates}


def record_store() -> dict[str, Array]:
    """Every group of cases."""
    tables = {name: record_group(name, group) for name, group in GROUPS.items()}
    return {f"{name}_{key}": value for name, table in tables.items() for key, value in table.items()}


# -- control -----------------------------------------------------------------------------------------------------------------

INERTIA = (82.115, 98.395, 121.022)
SPIN_INERTIA = 50.0 / (6000.0 * 2.0 * np.pi / 60.0)
GAINS = (
    # K1, K3, omega_max, servo_Ki, servo_P
    (0.25, 3.0, np.radians(3.0), 5.0, 150.0),
    (0.5, 3.0, np.radians(5.0), 5.0, 30.0),
    (0.25, 3.0, np.radians(3.0), 0.05, 150.0),
    (0.25, 1.0, np.radians(1.0), -1.0, 20.0),
)
"""bsk_rl's defaults, those of an agile satellite, a loose integral, none at all."""

STEERING_H_NS, STEERING_ON = 500_000_000, (0, 1, 1, 1, 0, 0, 1, 1, 1, 1)
SIZES = np.repeat((0.4, 0.02, 1e-3, 1e-6, 200.0), 3)
"""Of sigma_BR, omega_BR_B, rad/s, omega_RN_B, rad/s, domega_RN_B, rad/s^2, and wheel speeds, rad/s."""


class Steering:
    """Steering law and rate servo of one satellite with three wheels on the body axes."""

    def __init__(self, gains: tuple[float, ...]) -> None:
        """Connect the modules as bsk_rl does."""
        self.law, self.servo = mrpSteering.mrpSteering(), rateServoFullNonlinear.rateServoFullNonlinear()
        self.law.K1, self.law.K3, self.law.omega_max, self.servo.Ki, self.servo.P = map(float, gains)
        self.law.ignoreOuterLoopFeedforward, self.servo.integralLimit = False, 2.0 / gains[3] * 0.1
        self.servo.knownTorquePntB_B = [0.0, 0.0, 0.0]
        self.guidance, self.speeds = messaging.AttGuidMsg(), messaging.RWSpeedMsg()
        self.torque = messaging.CmdTorqueBodyMsgReader()
        vehicle = messaging.VehicleConfigMsgPayload(ISCPntB_B=np.diag(INERTIA).flatten().tolist())
        wheels = messaging.RWArrayConfigMsgPayload(GsMatrix_B=np.eye(3).flatten().tolist(), JsList=[SPIN_INERTIA] * 3, numRW=3)
        self.fixed = messaging.VehicleConfigMsg().write(vehicle), messaging.RWArrayConfigMsg().write(wheels)
        for module in (self.law, self.servo):
            module.guidInMsg.subscribeTo(self.guidance)
        self.servo.vehConfigInMsg.subscribeTo(self.fixed[0])
        self.servo.rwParamsInMsg.subscribeTo(self.fixed[1])
        self.servo.rwSpeedsInMsg.subscribeTo(self.speeds)
        self.servo.rateSteeringInMsg.subscribeTo(self.law.rateCmdOutMsg)
        self.torque.subscribeTo(self.servo.cmdTorqueOutMsg)
        self.clock = Clock(STEERING_H_NS, [self.law, self.servo], enabled=False)

    def tick(self, on: int, inputs: Array) -> list[float]:
        """Torque, N m, that the servo asks of the body after a tick; that of earlier where the task is off."""
        sigma, omega, omega_R, domega_R, speeds = inputs.reshape(5, 3).tolist()
        guidance = messaging.AttGuidMsgPayload(sigma_BR=sigma, omega_BR_B=omega, omega_RN_B=omega_R, domega_RN_B=domega_R)
        self.guidance.write(guidance, self.clock.now)
        self.speeds.write(messaging.RWSpeedMsgPayload(wheelSpeeds=speeds), self.clock.now)
        self.clock.tick(bool(on))
        return list(self.torque().torqueRequestBody) if self.torque.isWritten() else [0.0] * 3


def record_steering() -> dict[str, Array]:
    """Torques [T, cases, 3] of the steering law and servo under random errors [T, cases, 15]."""
    rng = np.random.default_rng(14)
    inputs = SIZES * rng.standard_normal((len(STEERING_ON), len(GAINS), len(SIZES)))
    torques = np.zeros((*inputs.shape[:2], 3))
    for case, gains in enumerate(GAINS):
        steering = Steering(gains)
        for k, on in enumerate(STEERING_ON):
            torques[k, case] = steering.tick(on, inputs[k, case])
    fixed = {"h_ns": np.array(STEERING_H_NS), "inertia": np.array(INERTIA), "on": np.array(STEERING_ON)}
    return {**fixed, "gains": np.array(GAINS), "inputs": inputs, "torque": torques}


CONTROLLER_INPUTS = ("attitude error", "rate error, rad/s", "access", "status", "new task", "on")
TOLERANCES = (0.01, 0.002)


def record_controller() -> dict[str, Array]:
    """Commands [T] of simpleInstrumentController under ``inputs`` [T, 6]; a new task clears what it has taken."""
    rng, ticks = np.random.default_rng(15), 200
    columns = [rng.choice(values, ticks) for values in ((0.004, 0.0099, 0.0101), (0.0, 0.0019, 0.0021))]
    columns += [held(rng, ticks, 0.3, lambda: float(rng.random() < 0.8)) for _ in range(2)]
    columns += [rng.choice(values, ticks) for values in ((0.0, 0.0, 0.0, 1.0), (0.0, 1.0, 1.0))]
    controller = simpleInstrumentController.simpleInstrumentController()
    controller.attErrTolerance, controller.useRateTolerance, controller.rateErrTolerance = TOLERANCES[0], 1, TOLERANCES[1]
    guidance, access = messaging.AttGuidMsg(), messaging.AccessMsg()
    controller.attGuidInMsg.subscribeTo(guidance)
    controller.locationAccessInMsg.subscribeTo(access)
    clock, inputs, commands = Clock(1_000_000_000, [controller], enabled=False), np.stack(columns, -1), []
    for sigma, omega, seen, status, new, on in inputs.tolist():
        # the tolerance is one of the norm, whichever way it points
        payload = messaging.AttGuidMsgPayload(sigma_BR=[0.6 * sigma, 0.0, -0.8 * sigma], omega_BR_B=[0.0, omega, 0.0])
        guidance.write(payload, clock.now)
        access.write(messaging.AccessMsgPayload(hasAccess=int(seen)), clock.now)
        controller.controllerStatus = int(status)
        if new:
            controller.imaged = 0
        clock.tick(bool(on))
        commands.append(controller.deviceCmdOutMsg.read().deviceCmd)
    return {"tolerances": np.array(TOLERANCES), "inputs": inputs, "command": np.array(commands, dtype=np.int8)}


RECORDERS: dict[str, Callable[[], dict[str, Array]]] = {
    "store": record_store,
    "steering": record_steering,
    "controller": record_controller,
}


def main() -> None:
    """Record the tables named on the command line."""
    parser = argparse.ArgumentParser(description="Record Basilisk's modules, each alone.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"tables to record, of {', '.join(RECORDERS)} (default: all)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "tests" / "sim" / "data")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(RECORDERS):
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or RECORDERS:
        target = arguments.out / f"{name}.npz"
        np.savez_compressed(target, **RECORDERS[name]())
        print(f"{name}: {target.stat().st_size / 1e3:.1f} kB", flush=True)


if __name__ == "__main__":
    main()
