//! The state machine, explored exhaustively: first the table, then the supervisor around it with its latch and vent watch.

extern crate std;

use std::collections::{HashSet, VecDeque};
use std::{assert_eq, format, println, vec, vec::Vec};

use super::*;

fn pairs() -> impl Iterator<Item = (State, Event)> {
    State::ALL.into_iter().flat_map(|state| Event::ALL.into_iter().map(move |event| (state, event)))
}

fn target(state: State, event: Event) -> Option<State> {
    match transition(state, event) {
        Transition::To(next) | Transition::IfUnblocked(next) => Some(next),
        Transition::Refuse => None,
    }
}

#[test]
fn a_fault_leads_to_the_fault_state_and_a_vent_to_a_vented_one_from_everywhere() {
    for state in State::ALL {
        assert_eq!(transition(state, Event::FaultRaised), Transition::To(State::Fault), "{state:?}");
        let Transition::To(vented) = transition(state, Event::Vent) else { panic!("{state:?} refuses to vent") };
        assert!(!vented.is_energised(), "{state:?}");
    }
}

#[test]
fn pressure_is_reached_by_arming_from_idle_alone_and_blockers_can_stop_it() {
    let ways: Vec<_> =
        pairs().filter(|(state, event)| !state.is_energised() && target(*state, *event).is_some_and(State::is_energised)).collect();
    assert_eq!(ways, [(State::Idle, Event::Arm)]);
    assert_eq!(transition(State::Idle, Event::Arm), Transition::IfUnblocked(State::Armed));
    let ways: Vec<_> = pairs().filter(|pair| target(pair.0, pair.1) == Some(State::Running)).collect();
    assert_eq!(ways, [(State::Armed, Event::Start)]);
}

#[test]
fn the_fault_state_is_left_by_acknowledgement_alone_and_into_a_self_test() {
    let ways: Vec<_> =
        Event::ALL.into_iter().filter(|event| target(State::Fault, *event).is_some_and(|next| next != State::Fault)).collect();
    assert_eq!(ways, [Event::Acknowledge]);
    assert_eq!(transition(State::Fault, Event::Acknowledge), Transition::IfUnblocked(State::SelfTest));
    // And idle, from which arming starts, is not reached without having passed the self-test or been energised before.
    for (state, event) in pairs().filter(|(state, event)| target(*state, *event) == Some(State::Idle) && *state != State::Idle) {
        assert!((state, event) == (State::SelfTest, Event::SelfTestPassed) || state.is_energised(), "{state:?} {event:?}");
    }
}

#[test]
fn every_state_is_reachable_and_every_state_but_fault_is_left_by_itself_or_a_command() {
    let mut reached = HashSet::from([State::Boot]);
    let mut queue = VecDeque::from([State::Boot]);
    while let Some(state) = queue.pop_front() {
        for event in Event::ALL {
            if let Some(next) = target(state, event)
                && reached.insert(next)
            {
                queue.push_back(next);
            }
        }
    }
    assert_eq!(reached.len(), State::ALL.len());
}

/// Everything the supervisor can see that matters in this state, in every combination.
fn observations(state: &SupervisorState) -> Vec<Observation> {
    let either = |matters: bool| if matters { vec![false, true] } else { vec![false] };
    let stopped: FaultSet = [Fault::EmergencyStop].into_iter().collect();
    let blocked: BlockerSet = [Blocker::LaserNotPlausible].into_iter().collect();
    let mut observations = Vec::new();
    // One tick, almost to every deadline, and past all of them.
    for elapsed_ticks in [1, VENT_WITHIN_TICKS - 1, u16::MAX] {
        for fault in [false, true] {
            for cause in either(state.state() == Faulted) {
                for blocker in either(matches!(state.state(), Idle | Armed)) {
                    for finished in either(state.state() == Running) {
                        for pressure_bar in [None, Some(0.05), Some(1.0)] {
                            for request in [None].into_iter().chain(Event::ALL.map(Some)) {
                                let blockers = if blocker { blocked } else { BlockerSet::EMPTY };
                                observations.push(Observation {
                                    elapsed_ticks,
                                    faults: if fault { stopped } else { FaultSet::EMPTY },
                                    causes: if cause { stopped } else { FaultSet::EMPTY },
                                    arm_blockers: blockers,
                                    start_blockers: blockers,
                                    pressure_bar,
                                    finished,
                                    request,
                                    ..Observation::default()
                                });
                            }
                        }
                    }
                }
            }
        }
    }
    observations
}

/// What tells two supervisors apart: counters are cut off where they have had their effect, times are before or past their deadline, and of
/// the faults only the one that has a cause is told from the others.
fn key(state: &SupervisorState) -> (State, Vent, [u32; 4], [bool; 3]) {
    let deadline = match state.state() {
        Boot => BOOT_TICKS,
        SelfTest => SELF_TEST_TICKS,
        Armed => 60_000,
        _ => u32::MAX,
    };
    let counters = [
        u32::from(state.ticks_in_state >= deadline),
        u32::from(state.vent_ticks.saturating_sub(VENT_WITHIN_TICKS - VENT_SEEN_TICKS - 1).min(VENT_SEEN_TICKS + 1)),
        u32::from(state.low_ticks.min(VENTED_FOR_TICKS)),
        u32::from(state.back_ticks.min(PRESSURE_BACK_TICKS)),
    ];
    let record = &state.record;
    (state.state(), state.vent(), counters, [record.first != 0, record.all.contains(Fault::EmergencyStop), record.second != 0])
}

/// Checks one step against everything the supervisor promises.
fn check(before: &SupervisorState, observation: &Observation, after: &SupervisorState, energised: bool, started: bool) {
    let (from, to) = (before.state(), after.state());
    let what = || format!("{before:?}\n{observation:?}\n{after:?}");
    assert_eq!(energised, to.is_energised(), "{}", what());
    if !from.is_energised() && to.is_energised() {
        assert_eq!((from, to, observation.request), (State::Idle, State::Armed, Some(Event::Arm)), "{}", what());
        assert!(observation.faults.is_empty() && observation.arm_blockers.is_empty(), "{}", what());
        assert_eq!(before.record().first, 0, "{}", what());
    }
    assert_eq!(started, from != State::Running && to == State::Running, "{}", what());
    if started {
        assert_eq!((from, observation.request), (State::Armed, Some(Event::Start)), "{}", what());
        assert!(observation.faults.is_empty() && observation.start_blockers.is_empty(), "{}", what());
    }
    if !observation.faults.is_empty() {
        assert_eq!(to, State::Fault, "{}", what());
    }
    if observation.request == Some(Event::Vent) {
        assert!(!energised, "{}", what());
    }
    assert_eq!(to == State::Fault, after.record().first != 0, "{}", what());
    if from == State::Fault && to == State::Fault {
        assert_eq!(before.record().first, after.record().first, "the first fault stays: {}", what());
        assert_eq!(after.record().all.0 & before.record().all.0, before.record().all.0, "{}", what());
    }
    if from == State::Fault && to != State::Fault {
        assert_eq!((to, observation.request), (State::SelfTest, Some(Event::Acknowledge)), "{}", what());
        assert_eq!(observation.causes.0 & before.record().all.0, 0, "{}", what());
        assert_eq!(after.vent(), Vent::Verified, "{}", what());
    }
    if from.is_energised() && !energised {
        assert_eq!(after.vent(), Vent::Watching, "leaving pressure begins the watch: {}", what());
    }
    if energised {
        assert_eq!(after.vent(), Vent::Unverified, "a vent from before says nothing: {}", what());
    }
}

#[test]
fn no_sequence_of_observations_breaks_a_promise_of_the_supervisor() {
    let supervisor: Supervisor = SupervisorConfig { arming_timeout_s: 60 }.build();
    let start = SupervisorState::default();
    let mut seen = HashSet::from([key(&start)]);
    let mut queue = VecDeque::from([start]);
    let mut states = HashSet::new();
    let mut vents = HashSet::new();
    let mut steps = 0;
    while let Some(state) = queue.pop_front() {
        states.insert(state.state());
        vents.insert(state.vent());
        for observation in observations(&state) {
            let mut next = state.clone();
            let decision = supervisor.step(&mut next, &observation);
            assert_eq!(decision.state, next.state());
            check(&state, &observation, &next, decision.energised, decision.started);
            steps += 1;
            if seen.insert(key(&next)) {
                queue.push_back(next);
            }
        }
    }
    println!("{} distinct situations, {steps} steps", seen.len());
    assert_eq!((states.len(), vents.len()), (State::ALL.len(), 4), "the exploration gets everywhere: {states:?} {vents:?}");
}

#[test]
fn an_armed_device_disarms_itself_when_nobody_starts() {
    let supervisor = SupervisorConfig { arming_timeout_s: 2 }.build();
    let mut state = SupervisorState::default();
    let quiet = Observation { elapsed_ticks: 1, pressure_bar: Some(0.0), ..Observation::default() };
    for _ in 0..BOOT_TICKS + 1 {
        supervisor.step(&mut state, &quiet);
    }
    supervisor.step(&mut state, &Observation { request: Some(Event::SelfTestPassed), ..quiet.clone() });
    supervisor.step(&mut state, &Observation { request: Some(Event::Arm), ..quiet.clone() });
    assert_eq!(state.state(), State::Armed);
    let expired = (1..5_000).find(|_| supervisor.step(&mut state, &quiet).arm_expired);
    assert_eq!((expired, state.state()), (Some(2_000), State::Idle));
}

#[test]
fn any_flipped_bit_of_the_state_or_the_vent_is_a_fault_and_opens_the_dump_valve() {
    let supervisor = SupervisorConfig { arming_timeout_s: 60 }.build();
    let quiet = Observation { elapsed_ticks: 1, pressure_bar: Some(0.0), ..Observation::default() };
    for state in State::ALL {
        for vent in [Vent::Unverified, Vent::Watching, Vent::Verified, Vent::Failed] {
            for (bit, of_vent) in (0..16).flat_map(|bit| [(bit, false), (bit, true)]) {
                let mut damaged =
                    SupervisorState { state: Redundant::new(state), vent: Redundant::new(vent), ..SupervisorState::default() };
                assert_eq!(damaged.dump_order().closes(), state.is_energised());
                if of_vent {
                    damaged.vent = damaged.vent.flipped(bit);
                } else {
                    damaged.state = damaged.state.flipped(bit);
                    assert!(!damaged.dump_order().closes(), "{state:?} bit {bit}: before the next tick");
                }
                let decision = supervisor.step(&mut damaged, &Observation { request: Some(Event::Arm), ..quiet.clone() });
                assert_eq!((decision.state, decision.energised), (State::Fault, false), "{state:?} {vent:?} bit {bit}");
                assert_eq!(damaged.record().first, Fault::InternalInconsistent.number());
                assert!(!damaged.dump_order().closes());
                assert_eq!(damaged.vent(), Vent::Watching, "the way down is watched");
            }
        }
    }
}
