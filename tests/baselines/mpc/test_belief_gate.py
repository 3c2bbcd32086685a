"""When a belief may be planned from."""

from baselines.mpc import belief_gate as module
from baselines.mpc.belief_gate import BeliefGate
from carosac_toolkit.base.scaled import Ratios

PERIOD = 0.02  # [s]
CAROSAC = Ratios(1.0, 1.0, 1.0)
TAUT, STUCK = (round(x.of(CAROSAC) / PERIOD) for x in (module.TAUT_TIME, module.STUCK_TIME))


def told(agreement, distance, *, resting, times=1):
    for _ in range(times):
        agreement.update(distance, resting=resting, still=True)
    return agreement


def test_a_plan_is_given_up_beyond_the_gate_at_once():
    agreement = told(BeliefGate(PERIOD, CAROSAC), 0.15, resting=False)
    assert agreement.usable
    assert not told(agreement, 0.25, resting=False).usable


def test_no_plan_begins_before_all_cables_have_been_taut_for_some_time():
    agreement = told(BeliefGate(PERIOD, CAROSAC), 0.3, resting=False)
    assert not told(agreement, 0.01, resting=True, times=TAUT - 1).usable
    assert not told(agreement, 0.1, resting=True).usable  # slack once more: it counts anew
    assert told(agreement, 0.01, resting=True, times=TAUT).usable


def test_a_lasting_disagreement_at_rest_is_noticed_and_a_passing_one_is_not():
    agreement = told(BeliefGate(PERIOD, CAROSAC), 0.1, resting=True, times=STUCK - 1)
    assert not agreement.stuck
    assert told(agreement, 0.1, resting=True).stuck
    assert not told(agreement, 0.01, resting=True).stuck


def test_solves_that_failed_at_beliefs_that_agree_may_be_tried_again_at_once():
    assert told(BeliefGate(PERIOD, CAROSAC), 0.01, resting=True).usable
