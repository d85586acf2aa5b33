"""Flight-software models: mode tables and commands; deriving from BSK-RL's tasks raises errors with advice."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NoReturn

from torch import Tensor

from bsk_torch.astro.frames import angle_between
from bsk_torch.sim.component import Component
from bsk_torch.sim.dyn.events import EMPTY_STORE_EVENT
from bsk_torch.sim.dyn.models import BasicDynamicsModel, DynamicsModel, ImagingDynModel, TorqueBarsDynModel
from bsk_torch.sim.fsw import (
    allocation,
    control,
    desaturation,
    guidance,
    imposed,
    instrument,
    manoeuvre,
    steering,
    target,
    unloading,
)
from bsk_torch.sim.fsw.desaturation import DUMP_RESET
from bsk_torch.sim.fsw.guidance import SUN_RESET
from bsk_torch.sim.fsw.instrument import IMAGE_RESET
from bsk_torch.sim.fsw.modes import Command, Mode
from bsk_torch.sim.instruments import axis_now
from bsk_torch.sim.names import nearest
from bsk_torch.sim.readout.model import Model
from bsk_torch.sim.readout.observables import Now, observable, vital
from bsk_torch.vec3 import Vec3

IDLE = "idle"
"""The mode before the first command: no task runs; on are the ``idle_flags`` of all components, those of devices."""


class FSWModel(Model):
    """Flight software without actuators: drift and nadir pointing with an imposed attitude.

    The attitude of a tick is exactly the reference of the previous tick. Until a guidance law writes a reference, and while the
    spacecraft drifts, it is zero: B equals N, at rest, regardless of ``sigma_init`` and ``omega_init``.

    ``modes`` maps names to rows of the mode table, and ``commands`` maps commands of actions to modes; both are merged with those
    of the base classes. None removes a mode of a base class. ``requires_dyn`` lists the required dynamics models, in addition to
    those of the base classes.
    """

    components: ClassVar[tuple[Component, ...]] = (guidance.NAVIGATION, imposed.HILL_REFERENCE, imposed.IMPOSED_ATTITUDE)
    modes: ClassVar[dict[str, Mode | None]] = {
        IDLE: Mode(on=None),
        "drift": Mode(on=()),
        "nadir_point": Mode(("nadir_on",)),
    }
    commands: ClassVar[dict[str, Command]] = {}
    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (DynamicsModel,)

    @classmethod
    def all_required_dyn(cls) -> tuple[type[DynamicsModel], ...]:
        """Return the dynamics models that the class and its bases require."""
        return tuple(dict.fromkeys(dynamics for base in cls.__mro__ for dynamics in vars(base).get("requires_dyn", ())))

    @classmethod
    def all_modes(cls) -> dict[str, Mode]:
        """Mode table of the class and its bases; ValueError if one removes a mode that those before it do not have.

        TypeError for an entry that is not a mode.
        """
        table: dict[str, Mode | None] = {}
        for base in reversed(cls.__mro__):
            for name, mode in vars(base).get("modes", {}).items():
                if not isinstance(mode, Mode | None):
                    raise TypeError(
                        f"{base.__name__}.modes[{name!r}]={mode!r} must be an fsw.Mode, or None to remove one of a base"
                    )
                if mode is None and name not in table:
                    raise ValueError(f"{base.__name__}.modes removes {name!r}, which no base class has; {nearest(name, table)}")
                table[name] = mode
        return {name: mode for name, mode in table.items() if mode is not None}

    @classmethod
    def all_commands(cls) -> dict[str, Command]:
        """Commands of the class and its bases; every mode is also a command of the same name. TypeError for other entries."""
        table = {name: Command((name,)) for name in cls.all_modes()}
        for base in reversed(cls.__mro__):
            for name, command in vars(base).get("commands", {}).items():
                if not isinstance(command, Command):
                    raise TypeError(f"{base.__name__}.commands[{name!r}]={command!r} must be an fsw.Command")
                table[name] = command
        return table


class BasicFSWModel(FSWModel):
    """MRP feedback with reaction wheels: drift, charge, nadir pointing, desaturation.

    The mode ``"nadir_point"`` aligns B with the Hill frame H: x points away from the Earth, z along the orbit normal. So an
    instrument looks down with ``inst_pHat_B=[-1, 0, 0]``, and along the horizon with the default, ``[0, 0, 1]``.
    """

    components: ClassVar[tuple[Component, ...]] = (
        imposed.ACTUATORS,
        guidance.SUN_POINTING,
        guidance.NADIR_POINTING,
        desaturation.DESATURATION,
        control.MRP_FEEDBACK,
        allocation.BODY_AXIS_WHEELS,
    )
    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (BasicDynamicsModel,)
    modes: ClassVar[dict[str, Mode | None]] = {
        "charge": Mode(("control_on", "sun_on"), SUN_RESET),
        "nadir_point": Mode(("control_on", "nadir_on")),
        "desat_sun": Mode(("control_on", "desat_on", "thruster_power", "sun_on"), SUN_RESET | DUMP_RESET),
        "desat_nadir": Mode(("control_on", "desat_on", "thruster_power", "nadir_on"), DUMP_RESET),
        "desat_none": Mode(("control_on", "desat_on", "thruster_power"), DUMP_RESET),
    }
    commands: ClassVar[dict[str, Command]] = {
        "desat": Command(("desat_sun", "desat_nadir", "desat_none"), choice="desatAttitude")
    }

    @observable
    def nadir_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument axis ``inst_pHat_B`` and the direction of the Earth's center, [N] rad.

        Of several ``instruments``, that of the one chosen last.
        """
        return angle_between(now.BN.mT @ axis_now(now), -now.r_BN_N)


class SteeringFSWModel(BasicFSWModel):
    """MRP steering with a rate servo instead of MRP feedback."""

    components: ClassVar[tuple[Component, ...]] = (steering.MRP_STEERING,)


class MagneticUnloadingFSWModel(BasicFSWModel):
    """Takes momentum from the wheels by magnetic torque bars while attitude is controlled; composed with other models."""

    components: ClassVar[tuple[Component, ...]] = (unloading.UNLOADING,)
    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (TorqueBarsDynModel,)


class ImagingFSWModel(BasicFSWModel):
    """Points the instrument at places on the ground, takes one image of each, and downlinks.

    The mode ``"image"`` points at the place in the state ``r_LP_P`` [m, Earth-fixed].
    """

    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (ImagingDynModel,)
    components: ClassVar[tuple[Component, ...]] = (guidance.LOCATION_POINTING, instrument.IMAGE_CONTROLLER, target.IMAGE_TARGET)
    modes: ClassVar[dict[str, Mode | None]] = {
        "downlink": Mode(("control_on", "nadir_on", "transmitter_on")),
        "image": Mode(("control_on", "location_on", "controller_on", "instrument_power"), IMAGE_RESET),
    }

    @observable
    def target_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument axis and the direction of the target chosen last, [N] rad.

        Before the first target is chosen, it is the place at zero latitude and longitude.
        """
        return angle_between(now.BN.mT @ axis_now(now), now.PN.mT @ now.r_LP_P - now.r_BN_N)

    @observable
    def c_hat_P(now: Now) -> Vec3:
        """Instrument axis in the Earth-fixed frame, [N, 3]; of several ``instruments``, that of the one chosen last."""
        return now.PN @ (now.BN.mT @ axis_now(now))

    @observable
    def c_hat_H(now: Now) -> Vec3:
        """Instrument axis in the Hill frame, [N, 3]; of several ``instruments``, that of the one chosen last."""
        return now.HN @ (now.BN.mT @ axis_now(now))


class ContinuousImagingFSWModel(ImagingFSWModel):
    """Scans along the ground track: the instrument records while it points at the Earth's center."""

    components: ClassVar[tuple[Component, ...]] = (target.EARTH_CENTRE_TARGET, instrument.SCANNING_CONTROLLER)
    modes: ClassVar[dict[str, Mode | None]] = {
        "image": None,
        "nadir_scan": Mode(("control_on", "location_on", "controller_on", "instrument_linked", "instrument_power")),
    }

    @observable
    def target_pointing_error(now: Now) -> Tensor:
        """Angle between the instrument axis and the direction of the Earth's center, the target of scans, [N] rad."""
        return angle_between(now.BN.mT @ axis_now(now), -now.r_BN_N)


class EndedDownlinkFSWModel(FSWModel):
    """Ends downlinks when the store is empty; :class:`bsk_torch.act.Downlink` adds it with ``until_empty``."""

    components: ClassVar[tuple[Component, ...]] = (EMPTY_STORE_EVENT,)
    requires_dyn: ClassVar[tuple[type[DynamicsModel], ...]] = (ImagingDynModel,)


class SteeringImagerFSWModel(SteeringFSWModel, ImagingFSWModel):
    """Imaging of places with MRP steering."""


class MagicOrbitalManeuverFSWModel(FSWModel):
    """Changes the velocity impulsively, limited by the remaining delta-v; composed with other flight software.

    ``Simulator.thrust(rows, dv_N)`` commands a maneuver, and actions such as ``act.ImpulsiveThrust`` call it. A satellite that
    uses its last fuel dies at the time of the maneuver, which is still executed. Fuel has no mass.
    """

    components: ClassVar[tuple[Component, ...]] = (manoeuvre.TANK,)

    @observable
    def dv_available(now: Now) -> Tensor:
        """Remaining delta-v, [N] m/s."""
        return now.dv_available

    @observable
    def thrust_count(now: Now) -> Tensor:
        """Number of maneuvers since reset, including those with zero velocity change, [N]."""
        return now.thrust_count

    @vital
    def fuel_remaining(now: Now) -> Tensor:
        """Whether more than 1e-8 m/s of delta-v remain, [N]."""
        return now.dv_available > manoeuvre.EMPTY


NO_GUIDANCE = Component(slot="nadir_pointing")  # nothing in the slot: for satellites that point nowhere


class TumblingFSWModel(FSWModel):
    """A passive satellite, rotated only by external torques.

    Its attitude starts from ``sigma_init`` and ``omega_init`` and follows Euler's equation ``I omega' = L - omega x (I omega)``
    with the inertia ``I`` of a uniform box of ``mass``, ``width``, ``depth`` and ``height``, or ``inertia`` (Schaub and Junkins,
    section 4.2). ``L`` is zero without disturbance or drag. Its only command is ``drift``. BSK-RL has no such model: it
    imposes the attitudes of satellites without actuators, see :class:`FSWModel`.
    """

    components: ClassVar[tuple[Component, ...]] = (imposed.ACTUATORS, NO_GUIDANCE)
    modes: ClassVar[dict[str, Mode | None]] = {"nadir_point": None}


NO_TASKS = (
    "flight software is a Component with update(bus), listed in components of the model, and a row of its table modes, which "
    "act.DiscreteFSWAction enters; see docs/how_to/own_fsw_mode.md"
)


class Task:
    """Base class of tasks; deriving from it raises TypeError."""

    def __init_subclass__(cls, **options: object) -> None:
        raise TypeError(f"{cls.__qualname__} is a task, which is never run here; {NO_TASKS}")


def action(function: Callable[..., object]) -> NoReturn:
    """Decorator of commands; raises TypeError."""
    raise TypeError(f"@action {function.__name__} is a command, which is never run here; {NO_TASKS}")
