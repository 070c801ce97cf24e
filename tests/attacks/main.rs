//! What attackers want, one file each, named after the wish. Every attack is made from outside: by the program's
//! command line, its files, or a second client of its protocols. It ends in [`Outcome::Refused`] with the refusal that
//! was read, in [`Outcome::Succeeded`] with what was achieved, or in [`Outcome::Otherwise`] if it failed for another
//! reason than the promised refusal: a gateway that is down refuses nothing. `tests/attacks/against BINARY` makes them
//! on another build.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(clippy::print_stdout, reason = "what an attack reached is told")]

#[path = "../support/mod.rs"]
mod support;

mod anchor_as_somebody_else;
mod answer_in_the_sites_place;
mod answer_without_an_end;
mod ask_for_every_log;
mod brick_the_chain_through_the_gateway;
mod enrolled_robot;
mod erase_another_owners_records;
mod fill_the_audit_log;
mod fill_the_pool;
mod fill_the_visitors_places;
mod find_erased_bytes;
mod forge_a_refusal;
mod forged_evidence;
mod freeze_the_contract_for_ever;
mod grant_to_a_gateways_key;
mod grow_the_directory;
mod hold_all_handshake_places;
mod lie_through_the_cache;
mod parts;
mod pass_off_an_old_chain;
mod poison_the_numbers;
mod read_the_core_dump;
mod read_the_owner_with_a_scoped_robot;
mod read_while_suspended;
mod read_with_a_recalled_robot;
mod read_with_replaced_keys;
mod readmit_oneself;
mod rekey_the_fleet_with_a_stolen_signing_key;
mod rename_a_topic;
mod run_a_command_by_completion;
mod run_a_copied_home;
mod served;
mod show_an_edited_time;
mod sign_after_the_loan;
mod sign_while_suspended;
mod stall_the_chain;
mod take_over_an_account_as_administrator;
mod take_the_robots_only_copy;
mod use_a_gateway_uninvited;
mod wear_a_reader_out;
mod work_beyond_an_operators_rights;

/// How an attack ended.
#[derive(Debug)]
pub enum Outcome {
    /// It achieved nothing; this is the refusal that was read.
    Refused(String),
    /// It achieved its goal.
    Succeeded(String),
    /// Neither: something else happened, in its own words.
    Otherwise(String),
}

/// Ends a test: an attack that was not refused by name fails it, unless only a report is wanted.
pub fn judge(attack: &str, outcome: Outcome) {
    let report = std::env::var_os("AUTHROS_ATTACKS_REPORT").is_some();
    match outcome {
        Outcome::Refused(refusal) => println!("REFUSED {attack}: {refusal}"),
        Outcome::Succeeded(reached) => {
            println!("SUCCEEDED {attack}: {reached}");
            assert!(report, "{attack} succeeded: {reached}");
        }
        Outcome::Otherwise(happened) => {
            println!("OTHERWISE {attack}: {happened}");
            assert!(report, "{attack} was neither refused by name nor did it succeed: {happened}");
        }
    }
}
