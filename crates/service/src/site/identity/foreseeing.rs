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
            let lines = vec!["nobody is affected: this profile is not registered on a chain yet".to_owned()];
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
            joined: self.config.site.as_ref().map(|site| clean(&site.addresses.join(", "), 600)),
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
        "{readers} with a grant: they can still open old and new records; anyone who compared your fingerprint must \
         compare the new one (`authros contacts confirm`)"
    )];
    let names: Vec<&str> = view.robots.iter().map(ProfileName::as_str).collect();
    lines.push(match names.as_slice() {
        [] => "no robot is on loan".to_owned(),
        names => format!(
            "{} ({}): informed by a notice signed with the old key and your account; they continue automatically if \
             their gateway runs in this home; enrol the others again",
            counted(names.len(), "robot", "robots"),
            clean(&names.join(", "), 200)
        ),
    });
    if view.keeps_gateway {
        lines.push(
            "this home's gateway keeps its identity, which robots and joined sites have pinned: the old key still \
             serves for that"
                .to_owned(),
        );
    }
    lines.extend(joined_line(view));
    lines
}

fn envelope_lines(view: &KeyChangeView) -> Vec<String> {
    let sharers = counted(view.sharers.len(), "account that shares", "accounts that share");
    let mut lines = vec![format!(
        "{sharers} with you: each re-wraps the current epoch's keys for the new key the next time it is active; the \
         old key stays in the keyring and opens what was sealed for it"
    )];
    if view.keeps_gateway {
        lines.push("transport keys kept by this home's gateway are sealed under the new key".to_owned());
    }
    lines.extend(joined_line(view));
    lines.push("your readers and robots are not affected".to_owned());
    lines
}

fn joined_line(view: &KeyChangeView) -> Option<String> {
    let gateway = view.joined.as_ref()?;
    Some(format!(
        "the gateway {gateway} that this home has joined: a new transport key is allocated there automatically"
    ))
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
        assert!(
            text.contains("0 readers") && text.contains("no robot is on loan") && !text.contains("gateway"),
            "{text}"
        );
        let text = envelope_lines(&KeyChangeView { sharers: vec![Address([2; 20])], ..nobody() }).join("\n");
        assert!(text.contains("1 account that shares") && text.contains("your readers and robots are not"), "{text}");
    }
}
