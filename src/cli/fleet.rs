//! `fleet`: the gateways with which the gateway of this home reconciles what it holds; what there is of them, for people.

use clap::Subcommand;

use super::connect::ProfileNeed;
use super::parse;
use super::verbs::{NEITHER, Plan};
use crate::model::Timestamp;
use crate::service::Failure;
use crate::service::command::{AddFellow, FleetStatus, ListFellows, RemoveFellow};
use crate::service::reply::{FellowView, FleetView};
use authros_output::table;

/// `fleet …`
#[derive(Debug, Subcommand)]
pub enum FleetVerb {
    /// Name a gateway of the same fleet; records go both ways once its keeper has named this one, too
    Add {
        /// Its address, HOST:PORT
        gateway: String,
        /// Its key, 64 hex characters, as its keeper passed it on (`authros fleet status` there)
        #[arg(long, value_name = "KEY")]
        gateway_key: String,
    },
    /// The gateways that were named
    List,
    /// Name a gateway no more: nothing is asked of it, and nothing handed to it
    Remove {
        /// Its address, its key, or the beginning of its key
        gateway: String,
    },
    /// How reconciling with each goes, and the address and key that the other keepers name
    Status,
}

/// What is asked.
///
/// # Errors
/// What is wrong with the arguments.
pub fn plan(verb: FleetVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        FleetVerb::Add { gateway, gateway_key } => {
            let key = parse::fingerprint(&gateway_key)?;
            Plan::new(NEITHER, ProfileNeed::None, AddFellow { address: gateway, key })
        }
        FleetVerb::List => Plan::new(NEITHER, ProfileNeed::None, ListFellows),
        FleetVerb::Remove { gateway } => Plan::new(NEITHER, ProfileNeed::None, RemoveFellow { gateway }),
        FleetVerb::Status => Plan::new(NEITHER, ProfileNeed::None, FleetStatus),
    })
}

fn time(at: Option<Timestamp>) -> String {
    at.map_or_else(|| "not yet".to_owned(), |at| at.to_string())
}

/// All gateways of the fleet.
pub fn all(fellows: &[FellowView]) -> String {
    if fellows.is_empty() {
        return "no other gateway; `authros fleet add HOST:PORT --gateway-key KEY` names one".to_owned();
    }
    let row = |one: &FellowView| {
        let (lacking, taken) = (one.lacking.to_string(), one.taken.to_string());
        vec![one.address.clone(), time(one.heard), lacking, taken, one.key.to_string()]
    };
    let rows: Vec<Vec<String>> = fellows.iter().map(row).collect();
    table(&["gateway", "heard", "lacking", "taken", "key"], &rows)
}

/// The same, with this home's own gateway and what is not well.
pub fn status(view: &FleetView) -> String {
    let own = match (&view.address, view.key) {
        (Some(address), Some(key)) => format!("this gateway: {address}, key {key}"),
        _ => "no gateway runs here; start it with authros gateway serve".to_owned(),
    };
    let mut lines = vec![own, all(&view.fellows)];
    if let Some(copies) = view.copies.filter(|_| !view.fellows.is_empty()) {
        let there = view.fellows.iter().filter(|one| !one.away).count() + 1;
        let how_many = if usize::from(copies) >= there { "all".to_owned() } else { copies.to_string() };
        lines.push(format!("each record is kept by {how_many} of the {there} gateways that are there (fleet.copies)"));
    }
    for one in &view.fellows {
        if one.away {
            lines.push(format!(
                "{}: away (fleet.away_after), so others keep what fell to it until it is back",
                one.address
            ));
        }
        lines.extend(one.problem.iter().map(|problem| format!("{}: {problem}", one.address)));
        if one.passed_over > 0 {
            let how = "`authros gateway admit` lets an owner use this gateway";
            lines.push(format!("{}: records of {} owners are not taken; {how}", one.address, one.passed_over));
        }
        if one.erased > 0 {
            lines.push(format!("{}: {} records were erased here too, as their owners state", one.address, one.erased));
        }
        if one.anchored_twice > 0 {
            lines.push(format!("{}: {} records were anchored by both", one.address, one.anchored_twice));
        }
        let refused = one.refused.iter();
        lines.extend(refused.map(|row| format!("{}: {} records refused: {}", one.address, row.count, row.text)));
    }
    if view.held > 0 {
        lines.push(format!(
            "{} records that their owner had erased elsewhere stay here, because incidents hold them; `authros incident remove \
             NAME --yes` lets them go",
            view.held
        ));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::SignerId;

    fn fellow(address: &str, away: bool) -> FellowView {
        FellowView {
            address: address.to_owned(),
            key: SignerId([7; 32]),
            account: None,
            added_at: Timestamp(0),
            heard: None,
            reconciled: false,
            lacking: 0,
            taken: 0,
            erased: 0,
            passed_over: 0,
            anchored_twice: 0,
            refused: Vec::new(),
            problem: None,
            away,
        }
    }

    fn told(copies: Option<u16>, fellows: Vec<FellowView>) -> String {
        status(&FleetView { address: None, key: None, fellows, held: 0, copies })
    }

    #[test]
    fn who_keeps_each_record_is_told_where_not_all_do() {
        let fellows = || ["a:1", "b:1", "c:1"].map(|address| fellow(address, address == "c:1")).to_vec();
        assert!(!told(None, fellows()).contains("kept by"));
        let some = told(Some(2), fellows());
        assert!(some.contains("each record is kept by 2 of the 3 gateways that are there"), "{some}");
        assert!(some.contains("c:1: away") && !some.contains("a:1: away"), "{some}");
        let few = told(Some(5), fellows());
        assert!(few.contains("kept by all of the 3 gateways"), "{few}");
        assert!(!told(Some(2), Vec::new()).contains("kept by"), "no fleet, nothing to say");
    }
}
