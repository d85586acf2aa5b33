"""Panels, facets, thrusters, wheels and partitions that cannot be."""

import math

import torch

from bsk_torch import ConstellationTasking, SatelliteTasking, act, dyn, faults, fsw, obs, sats
from bsk_torch.presets.nadir_scan import ScanningSatellite
from bsk_torch.sim.dyn.effectors.thrusters import OCTET
from bsk_torch.sim.dyn.storage.partitions import partition_names
from tests.sim.dyn.flights import fly
from tests.support.refusals import check_refusals, refusal

ZERO = [0, 0, 0]


def test_rejects_impossible_panels_thrusters_and_partitions():
    def panel(**wrong):
        return dyn.Panel(**({"normal": [0, 0, -1], "area": 1.0, "efficiency": 0.3} | wrong))

    def wing(**wrong):
        return panel(**{"axis": [1, 0, 0], "rate": 0.1} | wrong)

    check_refusals(
        refusal(lambda: panel(area=-1.0), ValueError, "Panel", "area=-1.0", "[0, 1e+06]"),
        refusal(lambda: panel(efficiency=1.2), ValueError, "Panel", "efficiency=1.2", "[0, 1]"),
        refusal(lambda: panel(normal=ZERO), ValueError, "Panel", "normal=[0, 0, 0]", "three numbers"),
        refusal(lambda: wing(axis=ZERO), ValueError, "Panel", "axis=[0, 0, 0]", "three numbers"),
        refusal(lambda: wing(axis=[1, 0, 1]), ValueError, "axis=(1.0, 0.0, 1.0)", "135 degrees", "normal=(0.0, 0.0, -1.0)"),
        refusal(lambda: panel(axis=[1, 0, 0]), ValueError, "Panel", "axis", "rate="),
        refusal(lambda: wing(rate=-0.1), ValueError, "Panel", "rate=-0.1"),
        refusal(lambda: wing(stops=[1.0, 2.0]), ValueError, "Panel", "angle=0", "stops=(1.0, 2.0)", "rad"),
        refusal(lambda: wing(stops=[1.0, -1.0]), ValueError, "stops=[1.0, -1.0]", "smallest", "largest"),
        refusal(lambda: wing(stops=[-4.0, 4.0]), ValueError, "stops=[-4.0, 4.0]", "2 pi"),
        refusal(lambda: panel(rate=0.1), ValueError, "rate=0.1", "axis="),
        refusal(lambda: faults.stuck_panel(), ValueError, "faults.stuck_panel", "normal", "panel="),
        refusal(lambda: faults.stuck_panel(ZERO), ValueError, "faults.stuck_panel", "normal=[0, 0, 0]", "three numbers"),
    )

    def fitted(thrusters=None, **args):
        return fly({"thrusters": thrusters} | args, (), orbit="integrated")

    octet, flat = list(OCTET), [dyn.Thruster([x, 0.0, 0.0], [0.0, y, 0.0], 1.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    still, kinds = [[0.0, 0.0, 0.0]] * 8, ("'MOOG_Monarc_2'", "'MOOG_Monarc_22_6'")
    check_refusals(
        refusal(lambda: fitted([]), ValueError, "thrusters=[]", "list of thrusters"),
        refusal(lambda: fitted([1.0]), ValueError, "thrusters=[1.0]", "list of thrusters"),
        refusal(lambda: fitted(flat), ValueError, "thrusters", "[-1.0, 0.0, 0.0]", "1 of 3 axes", "desaturation"),
        refusal(lambda: fitted(thrusterMaxThrust=[1.0] * 8), ValueError, "thrusterMaxThrust", "thrusters=["),
        refusal(lambda: fitted(octet, thrusterMaxThrust=[1.0] * 7), ValueError, "thrusterMaxThrust", "8 numbers", "[7]"),
        refusal(lambda: fitted(octet, thrusterMaxThrust=0.0), ValueError, "thrusterMaxThrust=0 N"),
        refusal(lambda: fitted(octet, thrusterDirections_B=still), ValueError, "thrusterDirections_B", "length zero"),
        refusal(lambda: dyn.Thruster([0, 0, 1], [1, 0, 0], 0.0), ValueError, "Thruster", "thrust=0"),
        refusal(lambda: dyn.Thruster([0, 0, 1], ZERO, 1.0), ValueError, "Thruster", "direction=[0, 0, 0]", "three numbers"),
        refusal(lambda: dyn.Thruster([0, 1], [1, 0, 0], 1.0), ValueError, "Thruster", "position=[0, 1]", "three numbers"),
        refusal(lambda: dyn.Thruster([0, 0, 1], [1, 0, 0], "MOOG_Monarc_2"), ValueError, *kinds),
    )

    def names(**given):
        return partition_names({"bufferNames": None, "transmitterNumBuffers": 100.0, "storageInit": 0.0} | given)

    whole, store = ("whole number", "1000"), ("list", "'STORED DATA'")
    check_refusals(
        refusal(lambda: names(transmitterNumBuffers=0), ValueError, "transmitterNumBuffers=0", *whole),
        refusal(lambda: names(transmitterNumBuffers=2.5), ValueError, "transmitterNumBuffers=2.5", *whole),
        refusal(lambda: names(transmitterNumBuffers=math.nan), ValueError, "transmitterNumBuffers=nan", *whole),
        refusal(lambda: names(transmitterNumBuffers=lambda: 3), ValueError, "NumBuffers=<function", "environments"),
        refusal(lambda: names(transmitterNumBuffers=2, bufferNames=["a"]), ValueError, "NumBuffers=2", "bufferNames=['a']"),
        refusal(lambda: names(bufferNames="ab"), ValueError, "bufferNames='ab'", *store),
        refusal(lambda: names(bufferNames=[]), ValueError, "bufferNames=[]", *store),
        refusal(lambda: names(bufferNames=["a", "a"]), ValueError, "bufferNames=['a', 'a']", *store),
        refusal(lambda: names(bufferNames=["a", "STORED DATA"]), ValueError, "bufferNames=['a', 'STORED DATA']", *store),
        refusal(lambda: names(bufferNames=[1, 2]), ValueError, "bufferNames=[1, 2]", *store),
    )


def test_rejects_wrong_arguments_of_panels():
    def fitted(count=2, **args):
        return fly({"panels": panels[:count], **args}, ())

    def broken(fault, count=2):
        return fitted(count, faults=[fault])

    wing = dict(axis=[0, 1, 0], rate=0.01)
    panels = [dyn.Panel([0, 0, -1], 0.5, 0.3, **wing), dyn.Panel([0, 0, -2], 0.5, 0.3, **wing, stops=[-1.0, 2.0])]
    fixed = dyn.Panel([0, 0, -1], 1.0, 0.3)
    mixed, stuck = [fixed, panels[0]], faults.stuck_panel
    skew = [[0, 0, 1], [0, 1, 1]]
    check_refusals(
        refusal(lambda: fly({"panels": 3}, ()), ValueError, "panels=3", "dyn.Panel"),
        refusal(lambda: fly({"panels": []}, ()), ValueError, "panels=[]", "dyn.Panel"),
        refusal(lambda: fly({"panelNormals_B": [[0, 0, 1]]}, ()), ValueError, "panelNormals_B", "panels=["),
        refusal(lambda: fitted(panelNormals_B=[ZERO, [0, 0, 1]]), ValueError, "panelNormals_B", "length zero"),
        refusal(lambda: fitted(panelNormals_B=skew), ValueError, "panelNormals_B", "panel 1", "perpendicular", "axis"),
        refusal(lambda: fitted(panelAngles=[0.0, 3.0]), ValueError, "panelAngles", "panel 1", "stops", "-1", "2 rad"),
        refusal(lambda: fly({"panels": mixed, "panelRates": [0.1, 0.1]}, ()), ValueError, "panelRates", "0", "panel 0"),
        refusal(lambda: fly({"panels": [fixed], "panelArea": -1.0}, ()), ValueError, "panelArea=-1 m^2"),
        refusal(lambda: fly({"panels": [fixed], "nHat_B": ZERO}, ()), ValueError, "nHat_B=[0, 0, 0]"),
        refusal(lambda: broken(faults.panel(0.5, 2)), ValueError, "panel2", "index=2"),
        refusal(lambda: broken(stuck([1, 0, 0])), ValueError, "'stuck_panel'", "faults.stuck_panel(normal, panel=0)"),
        refusal(lambda: broken(stuck([1, 0, 0], 0)), ValueError, "'stuck_panel0'", "faults.stuck_panel(panel=k)"),
        refusal(lambda: fly({"panels": [fixed], "faults": [stuck(panel=0)]}, ()), ValueError, "'stuck_panel0'", "['panel']"),
        refusal(lambda: fly({"faults": [faults.panel(0.5, 0)]}, ()), ValueError, "panel0", "index=0", "one number"),
    )


def test_rejects_wrong_facets_and_bars():
    class Loaded(sats.Satellite):
        observation_spec = (obs.Time(),)
        action_spec = (act.Drift(duration=60.0),)
        dyn_type = (dyn.SolarPressureDynModel, dyn.TorqueBarsDynModel, dyn.BasicDynamicsModel)
        fsw_type = (fsw.MagneticUnloadingFSWModel, fsw.BasicFSWModel)

    def loaded(**args):
        return SatelliteTasking(Loaded("A", args), num_envs=1, backend="eager")

    def facet(**wrong):
        return dyn.Facet(**({"area": 1.0, "normal": [1, 0, 0], "position": ZERO} | wrong))

    bars, light = [dyn.TorqueBar(axis, 30.0) for axis in torch.eye(3).tolist()], {"diffuseCoeff": 0.6, "specularCoeff": 0.6}
    check_refusals(
        refusal(lambda: loaded(torqueBars=bars), ValueError, "facets=None", "sunlight"),
        refusal(lambda: loaded(facets=dyn.box_facets([1, 1, 1])), ValueError, "torqueBars=None", "list of bars"),
        refusal(lambda: loaded(torqueBars=bars, facets=[1.0]), ValueError, "facets=[1.0]", "list of facets"),
        refusal(lambda: facet(normal=ZERO), ValueError, "Facet", "normal=[0, 0, 0]"),
        refusal(lambda: facet(**light), ValueError, "Facet", "diffuseCoeff=0.6", "specularCoeff=0.6", "sum"),
    )


def hr16(*axes):
    return [dyn.Wheel("Honeywell_HR16", axis, 50.0) for axis in axes]


def test_rejects_wheels_that_do_not_exist():
    def custom(**numbers):
        return dyn.Wheel("custom", [1, 0, 0], Omega_max=100.0, **numbers)

    momenta = "[100.0, 75.0, 50.0]"
    check_refusals(
        refusal(lambda: dyn.Wheel("Honeywell_HR61", [1, 0, 0]), ValueError, "'Honeywell_HR61'", "'Honeywell_HR16'"),
        refusal(lambda: dyn.Wheel("Honeywell_HR16", [1, 0, 0]), ValueError, "'Honeywell_HR16'", "maxMomentum", "Js", momenta),
        refusal(lambda: dyn.Wheel("Honeywell_HR16", [1, 0, 0], 60.0), ValueError, "maxMomentum=60 N m s", momenta),
        refusal(lambda: dyn.Wheel("BCT_RWP015", ZERO), ValueError, "'BCT_RWP015'", "axis=[0, 0, 0]", "three numbers"),
        refusal(lambda: custom(maxMomentum=1.0, Js=0.1, u_max=1.0), ValueError, "'custom'", "Js=0.1", "maxMomentum=1"),
        refusal(lambda: custom(Js=0.1), ValueError, "'custom'", "u_max"),
        refusal(lambda: custom(Js=-0.1, u_max=1.0), ValueError, "'custom'", "Js=-0.1"),
    )


def test_rejects_wrong_arguments_of_wheels():
    def fitted(**args):
        return fly({"wheels": hr16(*dyn.pyramid(0.8)), **args}, ())

    def two(first, second):
        three = {"wheels": hr16(*axes)}
        return ConstellationTasking([ScanningSatellite("A", three | first), ScanningSatellite("B", three | second)], num_envs=1)

    axes, tilted = torch.eye(3).tolist(), [[1.0, 0, 0], [0, 1.0, 0], [0, 0.1, 1.0]]
    flat, pair, ahead = hr16([1, 0, 0], [0, 1, 0], [1, 1, 0]), hr16([1, 0, 0.2], [0, 1, 0]), [[1.0, 0, 0]] * 3
    check_refusals(
        refusal(lambda: fitted(wheels="HR16"), ValueError, "wheels='HR16'", "list of wheels"),
        refusal(lambda: fitted(wheels=[]), ValueError, "wheels=[]", "flight software"),
        refusal(lambda: fitted(wheels=flat), ValueError, "wheels", "[[1.0, 0.0, 0.0], ", "2 of 3 dimensions"),
        refusal(lambda: fitted(wheels=pair), ValueError, "wheels", "[[0.98", "2 of 3 dimensions"),
        refusal(lambda: fitted(rwAxes_B=ahead), ValueError, "rwAxes_B", "[4, 3]", "[3, 3]"),
        refusal(lambda: fitted(rwJs=[0.1] * 3), ValueError, "rwJs", "4 numbers", "[3]"),
        refusal(lambda: fitted(rwJs=0.0), ValueError, "rwJs=0 kg m^2"),
        refusal(lambda: fitted(rwBetaStatic=0.0), ValueError, "rwBetaStatic=0 "),
        refusal(lambda: fitted(rwElecToMechEfficiency=0.0), ValueError, "rwElecToMechEfficiency=0 "),
        refusal(lambda: fitted(rwJs=500.0), ValueError, "mass=330", "500, 500, 500, 500 kg m^2"),
        refusal(lambda: fitted(u_max=500.0), ValueError, "u_max=500 N m", "one tick", "sim_rate"),
        refusal(lambda: fly({"nullSpaceGain": 0.01}, ()), ValueError, "nullSpaceGain=0.01", "three wheels"),
        refusal(lambda: fitted(rwAxes_B=[*ahead, [0.0, 0, 0]]), ValueError, "rwAxes_B", "length zero"),
        refusal(lambda: two({"rwFCoulomb": 0.0}, {"rwFCoulomb": 1e-3}), ValueError, "rwFCoulomb=0.001", "type"),
        refusal(lambda: two({"rwAxes_B": axes}, {"rwAxes_B": tilted}), ValueError, "rwAxes_B", "wheel 2", "axis 2", "type"),
    )
