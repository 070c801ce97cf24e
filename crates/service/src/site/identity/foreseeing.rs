//! Who is affected by a change of an SM2 pair, reported before it is made.

use super::Profiles;
use std::sync::Arc;

use tokio::task::block_in_place;

use crate::crypto::signer_id;
use crate::gateway::Cabinet;
use crate::model::{Address, ProfileName, clean};
use crate::pipeline::authority::{self, Moment, may_sign};
use crate::pipeline::directory::Granted;
use crate::pipeline::{Network, Owner};
use crate::service::command::PairKind;
use crate::service::reply::{Failure, KeyChangeView};

impl Profiles {
    /// Who is affected, and what happens then; changes nothing.
    pub(in crate::site) async fn foresee_key_change(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        kind: PairKind,
    ) -> Result<KeyChangeView, Failure> {
        let network = self.registered_network(owner).await?;
        let Some(network) = network else {
            let lines = vec!["nobody is touched: this profile is not registered on a chain yet".to_owned()];
            return Ok(KeyChangeView { lines, ..nobody() });
        };
        let me = owner.address;
        let identity = owner.gateway_identity().public;
        let founded = block_in_place(|| Cabinet::founded_in(&self.home.gateway()));
        let mut view = KeyChangeView {
            readers: parties(&authority::standing_grants(&network.directory, me), |grant| grant.terms.grantee),
            sharers: parties(&authority::shared_with(&network.directory, me), |grant| grant.terms.owner),
            robots: self.lent_robots(owner, &network)?,
            keeps_gateway: founded == Some(signer_id(&identity)),
            joined: self.config.site.as_ref().map(|profiles| clean(&profiles.address, 255)),
            lines: Vec::new(),
        };
        view.lines = match kind {
            PairKind::Signing => signing_lines(&view),
            PairKind::Envelope => envelope_lines(&view),
        };
        Ok(view)
    }

    fn lent_robots(&self, owner: &Owner, network: &Network) -> Result<Vec<ProfileName>, Failure> {
        let now = Moment::newest(network.directory.now());
        let lent = |device| may_sign(&network.directory, owner.address, device, now).is_ok();
        let enrolled = self.enrolments.of(owner)?.into_iter();
        Ok(enrolled.filter(|device| lent(device.device)).map(|device| device.name).collect())
    }
}

fn nobody() -> KeyChangeView {
    KeyChangeView {
        readers: Vec::new(),
        sharers: Vec::new(),
        robots: Vec::new(),
        keeps_gateway: false,
        joined: None,
        lines: Vec::new(),
    }
}

/// The other side of every grant, each once.
fn parties(grants: &[Granted], other: impl Fn(&Granted) -> Address) -> Vec<Address> {
    let mut found: Vec<Address> = grants.iter().map(other).collect();
    found.sort();
    found.dedup();
    found
}

fn counted(count: usize, one: &str, many: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {many}") }
}

fn signing_lines(view: &KeyChangeView) -> Vec<String> {
    let readers = counted(view.readers.len(), "reader", "readers");
    let mut lines = vec![format!(
        "{readers} with a grant: they go on and open old and new records; who compared your fingerprint compares the \
         new one (`authros contacts confirm`)"
    )];
    let names: Vec<&str> = view.robots.iter().map(ProfileName::as_str).collect();
    lines.push(match names.as_slice() {
        [] => "no robot is lent".to_owned(),
        names => format!(
            "{} ({}): told by a notice that the old key and your account sign; they go on by themselves where their \
             gateway runs in this home and they are not of an earlier version; enrol the others again",
            counted(names.len(), "robot", "robots"),
            clean(&names.join(", "), 200)
        ),
    });
    if view.keeps_gateway {
        lines.push(
            "the gateway of this home keeps its identity, which robots and joined sites have pinned: the old key still \
             serves as that"
                .to_owned(),
        );
    }
    lines.extend(joined_line(view));
    lines
}

fn envelope_lines(view: &KeyChangeView) -> Vec<String> {
    let sharers = counted(view.sharers.len(), "account that shares", "accounts that share");
    let mut lines = vec![format!(
        "{sharers} with you: each wraps the present epoch's keys anew for the new key when it is next at work; the old \
         key stays in the keyring and opens what was sealed to it"
    )];
    if view.keeps_gateway {
        lines.push("transport keys that the gateway of this home keeps are sealed under the new key".to_owned());
    }
    lines.extend(joined_line(view));
    lines.push("readers and robots of yours are not touched".to_owned());
    lines
}

fn joined_line(view: &KeyChangeView) -> Option<String> {
    let gateway = view.joined.as_ref()?;
    Some(format!("the gateway {gateway} that this home has joined: a new transport key is allocated there by itself"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everybody_touched_is_named_and_nobody_else() {
        let robots = vec!["scout-1".parse().expect("a name"), "scout-2".parse().expect("a name")];
        let view = KeyChangeView {
            readers: vec![Address([1; 20])],
            robots,
            keeps_gateway: true,
            joined: Some("far:7000".to_owned()),
            ..nobody()
        };
        let text = signing_lines(&view).join("\n");
        for word in ["1 reader ", "2 robots (scout-1, scout-2)", "keeps its identity", "far:7000"] {
            assert!(text.contains(word), "{word} in {text}");
        }
        let text = signing_lines(&nobody()).join("\n");
        assert!(text.contains("0 readers") && text.contains("no robot is lent") && !text.contains("gateway"), "{text}");
        let text = envelope_lines(&KeyChangeView { sharers: vec![Address([2; 20])], ..nobody() }).join("\n");
        assert!(
            text.contains("1 account that shares") && text.contains("readers and robots of yours are not"),
            "{text}"
        );
    }
}
