//! The first steps of a new profile, with the key for each.

use super::state::State;

/// One step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirstStep {
    /// Whether it is done.
    pub done: bool,
    /// The key to press.
    pub key: &'static str,
    /// What it brings.
    pub text: &'static str,
}

/// The steps while one that matters is open; empty when the profile is set up.
pub fn first_steps(state: &State) -> Vec<FirstStep> {
    let Some(identity) = &state.identity else { return Vec::new() };
    let set_up = identity.exists && identity.registered;
    let steps = vec![
        FirstStep { done: set_up, key: "n", text: "identity: make keys, register them on the chain" },
        FirstStep { done: identity.exists, key: "L", text: "keys: made with the identity; L loads your own" },
        FirstStep { done: state.watches(), key: "w", text: "topics: watch one; its messages are sealed and anchored" },
        FirstStep { done: state.grants.any_given(), key: "g", text: "grant: let another account open them" },
    ];
    if steps.iter().all(|step| step.done) { Vec::new() } else { steps }
}
