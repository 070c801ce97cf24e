//! Who is affected by a change of an SM2 pair, reported before it is made.

use super::Profiles;

use tokio::task::block_in_place;

use crate::command::PairKind;
use crate::crypto::signer_id;
use crate::gateway::Cabinet;
use crate::model::{Address, ProfileName, clean, counted};
use crate::pipeline::{Granted, Owner, authority};
use crate::reply::{KeyChangeView, Result};

impl Profiles {
    pub async fn foresee_key_change(&self, owner: &Owner, kind: PairKind) -> Result<KeyChangeView> {
        let network = self.registered_network(owner).await?;
        let Some(network) = network else {
            let lines = vec!["nobody is affected: this profile is not registered on a chain yet".to_owned()];
            return Ok(KeyChangeView { lines, ..KeyChangeView::default() });
        };
        let me = owner.address;
        let identity = owner.gateway_identity().public;
        let founded = block_in_place(|| Cabinet::founded_in(&self.parts.home.gateway()));
        let mut view = KeyChangeView {
            readers: parties(&authority::standing_grants(&network.directory, me), |grant| grant.terms.grantee),
            sharers: parties(&authority::shared_with(&network.directory, me), |grant| grant.terms.owner),
            robots: self.enrolments.lent(owner, &network)?.into_iter().map(|robot| robot.name).collect(),
            keeps_gateway: founded == Some(signer_id(&identity)),
            joined: self.parts.config.site.as_ref().map(|site| clean(&site.addresses.join(", "), 600)),
            lines: Vec::new(),
        };
        view.lines = match kind {
            PairKind::Signing => signing_lines(&view),
            PairKind::Envelope => envelope_lines(&view),
        };
        Ok(view)
    }
}

fn parties(grants: &[Granted], other: impl Fn(&Granted) -> Address) -> Vec<Address> {
    let mut found: Vec<Address> = grants.iter().map(other).collect();
    found.sort();
    found.dedup();
    found
}

fn signing_lines(view: &KeyChangeView) -> Vec<String> {
    let compare = "anyone who compared your fingerprint must compare the new one (`authros contacts confirm`)";
    let mut lines = vec![match view.readers.len() {
        0 => format!("no reader has a grant; {compare}"),
        count => {
            let readers = counted(count as u64, "reader");
            format!("{readers} with a grant: they can still open old and new records; {compare}")
        }
    }];
    let names: Vec<&str> = view.robots.iter().map(ProfileName::as_str).collect();
    lines.push(match names.as_slice() {
        [] => "no robot is authorised".to_owned(),
        names => format!(
            "{} ({}): informed by a notice signed with the old key and your account; they continue automatically if \
             their gateway runs in this home; enrol the others again",
            counted(names.len() as u64, "robot"),
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
    let sharers = match view.sharers.len() as u64 {
        1 => "1 account that shares".to_owned(),
        several => format!("{} that share", counted(several, "account")),
    };
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
            ..KeyChangeView::default()
        };
        let text = signing_lines(&view).join("\n");
        for word in ["1 reader ", "2 robots (scout-1, scout-2)", "keeps its identity", "far:7000"] {
            assert!(text.contains(word), "{word} in {text}");
        }
        let text = signing_lines(&KeyChangeView::default()).join("\n");
        assert!(
            text.contains("no reader has a grant")
                && text.contains("no robot is authorised")
                && !text.contains("gateway"),
            "{text}"
        );
        let text =
            envelope_lines(&KeyChangeView { sharers: vec![Address([2; 20])], ..KeyChangeView::default() }).join("\n");
        assert!(text.contains("1 account that shares") && text.contains("your readers and robots are not"), "{text}");
    }
}
