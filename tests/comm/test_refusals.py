"""Wrong calls of communication: what each must raise, and what its message must name."""

import math

import torch

from bsk_torch import act, comm
from bsk_torch.sim import dyn
from bsk_torch.tasks.objects import CatalogCommunication, RSOImageReward, TransmitCatalog
from tests.comm.fleets import drawn_elements, make_fleet, states
from tests.comm.test_comm import ALL, Given, GivenBroadcast, linked
from tests.comm.test_hooks_of_communicators import attached
from tests.support.refusals import check_refusals, refusal
from tests.tasks.objects.objects import Imager
from tests.tasks.objects.test_comm import Sender, team


def test_rejects_wrong_arguments():
    transmit, catalogs = TransmitCatalog, CatalogCommunication
    broadcast = lambda seconds: act.Broadcast(duration=seconds)
    table = [
        *(refusal(lambda x=x: broadcast(x), ValueError, "'action_broadcast'", f"duration={x}") for x in (0.0, -3.0, math.nan)),
        refusal(lambda: comm.FreeCommunication(min_period=-1), ValueError, "min_period=-1"),
        refusal(lambda: transmit(0), ValueError, "n_peers=0"),
        refusal(lambda: transmit(1, max_duration=0.0), ValueError, "max_duration=0.0"),
        refusal(lambda: transmit(1, min_hold_s=-1.0), ValueError, "min_hold_s=-1.0"),
        refusal(lambda: transmit(1, bits_per_second=0.0), ValueError, "bits_per_second=0.0"),
        refusal(lambda: transmit(1, link_mode="laser"), ValueError, "link_mode='laser'", "'los'", "'ideal'"),
        refusal(lambda: catalogs(delay_s=-1.0), ValueError, "delay_s=-1.0"),
        refusal(lambda: catalogs(loss_probability=2.0), ValueError, "loss_probability=2.0"),
        refusal(lambda: catalogs(delay_s=10.0, ttl_s=5.0), ValueError, "ttl_s=5.0", "delay_s=10.0"),
    ]
    check_refusals(table)


def test_rejects_teams_that_cannot_transmit():
    def crew(*actions, base=Sender, **options):
        kind = type("Mine", (base,), {"action_spec": (*Imager.action_spec, *actions)})
        return team(kind=kind, backend="eager", **options)

    one, again, delivery = TransmitCatalog(1), TransmitCatalog(1, name="again"), "communicator=CatalogCommunication"
    common = dict(knowledge="common", rewarder=RSOImageReward(multi_imager_credit="shared"))
    table = [
        refusal(lambda: crew(one, base=Imager), ValueError, "TransmitCatalog", "CatalogRadioDynModel"),
        refusal(lambda: crew(one, again), ValueError, "'Imager0'", "two actions", "TransmitCatalog"),
        refusal(lambda: crew(TransmitCatalog(2)), ValueError, "n_peers=2", "2 imagers", "1 peers"),
        refusal(lambda: crew(one, communicator=None), ValueError, delivery),
        refusal(lambda: crew(one, communicator=comm.FreeCommunication()), ValueError, delivery, "FreeCommunication"),
        refusal(lambda: crew(base=Imager), ValueError, "CatalogCommunication", "TransmitCatalog"),
        refusal(lambda: crew(one, **common), ValueError, "CatalogCommunication", "knowledge='own'"),
    ]
    check_refusals(table)


def test_rejects_fleets_without_what_a_method_needs():
    fleet = make_fleet(states(drawn_elements(3)), types=[[0, 2], [1]])
    fleet.satellites[1].dyn_type = dyn.ImagingDynModel
    table = [
        refusal(lambda: linked(GivenBroadcast(), 3, talkers=0), ValueError, "GivenBroadcast", "act.Broadcast()"),
        refusal(lambda: comm.LOSCommunication().link(fleet), TypeError, "LOSCommDynModel", "Sat1", "ImagingDynModel"),
    ]
    check_refusals(table)


def test_rejects_orbits_that_are_not_computed_in_advance():
    fleet, method = make_fleet(states(drawn_elements(2)), orbit="integrated"), comm.LOSMultiCommunication
    check_refusals([refusal(lambda: method().link(fleet), ValueError, "Sat0", "orbit='integrated'", "orbit='arc'")])


def test_rejects_methods_that_do_not_fit():
    class LateMulti(comm.FreeCommunication, comm.MultiDegreeCommunication):
        """The wrong way round."""

    class Lost(comm.FreeCommunication):
        def link(self, fleet):
            pass

    def paired(pairs):
        method = linked(Given())
        method.pairs = pairs
        return method.communicate(ALL)

    define = lambda result: type("Wrong", (comm.FreeCommunication,), {"communicate": lambda self, moves: result})
    exchanged = lambda result: attached(define(result)()).exchange(ALL)
    boolean = dict(dtype=torch.bool)
    table = [
        refusal(lambda: linked(comm.CommunicationMethod()).communicate(ALL), NotImplementedError, "communication_pairs"),
        refusal(lambda: paired(torch.ones(3, 3, 3)), TypeError, "torch.float32", "torch.bool", [3, 3, 3]),
        refusal(lambda: paired(torch.ones(3, 3, **boolean)), TypeError, [3, 3], "torch.bool", [3, 3, 3]),
        refusal(lambda: linked(comm.BroadcastCommunication()), TypeError, "BroadcastCommunication", "LOSCommunication"),
        refusal(lambda: linked(comm.MultiDegreeCommunication()), TypeError, "MultiDegreeCommunication", "LOSCommunication"),
        refusal(lambda: linked(LateMulti()), TypeError, "LateMulti", "MultiDegreeCommunication", "LOSCommunication"),
        refusal(lambda: attached(Lost()), TypeError, "Lost.link(fleet)", "super().link(fleet)"),
        refusal(lambda: exchanged(torch.ones(3, 3, 3)), TypeError, "Wrong.communicate(moves)", "torch.float32", "torch.bool"),
        refusal(lambda: exchanged(torch.ones(3, 2, 2, **boolean)), TypeError, "Wrong.communicate(moves)", [3, 2, 2], [3, 3, 3]),
        refusal(lambda: exchanged(None), TypeError, "Wrong.communicate(moves)", None),
    ]
    check_refusals(table)


def test_rejects_definitions_that_would_not_run():
    resets = "reset_overwrite_previous", "reset_pre_sim_init", "reset_during_sim_init", "reset_post_sim_init", "reset"
    wrong = [
        ("link_satellites", "link(fleet)"),
        *((name, "self.fleet.memory") for name in resets),
        ("after_step", "communication_pairs()"),
        ("exchange", "communicate(moves)"),
        ("communicaton_pairs", "'communication_pairs'"),
        ("communication_pair", "'communication_pairs'"),
    ]
    define = lambda base, name: type("Mine", (base,), {name: lambda self: None})
    free, communicate = comm.FreeCommunication, ("Mine.communicate(self)", "communicate(moves)")
    table = [
        *(
            refusal(lambda base=base, name=name: define(base, name), TypeError, f"Mine.{name}", advice)
            for base in (comm.CommunicationMethod, comm.NoCommunication, comm.LOSMultiCommunication)
            for name, advice in wrong
        ),
        refusal(lambda: define(free, "communicate"), TypeError, *communicate),  # that of bsk_rl has no argument
    ]
    check_refusals(table)
