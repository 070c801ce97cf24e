//! What a robot keeps of the policy that its owner set for it, checked when it arrives.

use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use tokio::sync::watch;

use crate::config::RobotPolicy;
use crate::crypto::{Enrolment, LONGEST_POLICY, SignedPolicy};
use crate::model::{Address, Domain, SignerId, clean};
use crate::pipeline::PipelineError;
use crate::pipeline::notices::PolicyTaker;
use crate::service::reply::Failure;
use crate::store::Ledger;

/// The widest text that reaches the owner, characters.
pub(super) const WIDEST: usize = 255;

/// What a robot keeps of its policy.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) struct Kept {
    /// The version taken up last; 0 = none yet.
    pub version: u64,
    /// Its text.
    pub text: String,
    /// The newest version heard of.
    pub heard: u64,
    /// Why the last one heard of was not taken up.
    pub refused: Option<String>,
}

/// Checks and keeps what the owner sets.
pub(super) struct PolicyKeeper {
    ledger: Ledger,
    domain: Domain,
    owner: Address,
    device: SignerId,
    kept: Mutex<Kept>,
    /// Rings when something else is kept.
    pub changed: watch::Sender<()>,
}

impl PolicyKeeper {
    /// For the robot of an enrolment; what it took up before is in force.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn open(ledger: &Ledger, enrolment: &Enrolment) -> Result<Self, Failure> {
        Self::of(ledger, enrolment.domain, enrolment.owner, enrolment.device_id())
    }

    pub(super) fn of(ledger: &Ledger, domain: Domain, owner: Address, device: SignerId) -> Result<Self, Failure> {
        let kept = ledger.setting(&place(&owner, &device))?;
        let kept = kept.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        let (ledger, changed) = (ledger.clone(), watch::channel(()).0);
        Ok(Self { ledger, domain, owner, device, kept: Mutex::new(kept), changed })
    }

    /// What is kept now.
    pub fn kept(&self) -> Kept {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The setting that says what the owner was told last, hex.
    pub fn told_place(&self) -> String {
        format!("robot policy told:{}:{}", self.owner, self.device)
    }

    /// The text of a policy that may be taken up after what is kept.
    fn judged(&self, policy: &SignedPolicy, kept: &Kept) -> Result<String, String> {
        let unsigned = |_| "the owner's account did not sign it for this robot".to_owned();
        policy.check(&self.domain, &self.owner, &self.device).map_err(unsigned)?;
        let (version, runs) = (policy.version, kept.version);
        if version < runs || version == 0 {
            return Err(format!("its version {version} is lower than {runs}, which this robot works by"));
        }
        if policy.text.len() > LONGEST_POLICY {
            return Err(format!("it has {} bytes, and {LONGEST_POLICY} are allowed", policy.text.len()));
        }
        let text = std::str::from_utf8(&policy.text).map_err(|_| "it is not UTF-8".to_owned())?;
        if version == runs && text != kept.text {
            return Err(format!("another policy with the same version {version} is in force here"));
        }
        RobotPolicy::read(text).map(|_| text.to_owned()).map_err(|error| clean(&error.to_string(), WIDEST))
    }
}

impl PolicyTaker for PolicyKeeper {
    fn take(&self, policy: &SignedPolicy) -> Result<String, PipelineError> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let (next, told) = match self.judged(policy, &kept) {
            Ok(text) => {
                let version = policy.version;
                let told = format!("the owner's policy {version} is in force from now on");
                (Kept { version, text, heard: version, refused: None }, told)
            }
            Err(why) => {
                let told = format!("the owner's policy {} is not taken up: {why}", policy.version);
                (Kept { heard: policy.version, refused: Some(why), ..kept.clone() }, told)
            }
        };
        let text = serde_json::to_string(&next).unwrap_or_default();
        self.ledger.put_setting(&place(&self.owner, &self.device), &text)?;
        *kept = next;
        self.changed.send_replace(());
        Ok(told)
    }
}

/// The setting of the robot's ledger that keeps the policy of one enrolment: another one in the same home has its own.
fn place(owner: &Address, device: &SignerId) -> String {
    format!("robot policy:{owner}:{device}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::EoaSecret;

    const DOMAIN: Domain = Domain([1; 32]);
    const DEVICE: SignerId = SignerId([9; 32]);
    const WATCH: &str = "[[watch]]\ntopic = \"/odom\"\n";

    #[test]
    fn a_policy_is_taken_up_signed_newer_and_valid_and_is_there_after_a_restart() {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let open = || PolicyKeeper::of(&ledger, DOMAIN, account.address(), DEVICE).expect("opens");
        let keeper = open();
        let signed = |by: &EoaSecret, version, text: &str| {
            SignedPolicy::sign(&DOMAIN, by, DEVICE, version, text).expect("signs")
        };
        let state = |keeper: &PolicyKeeper| {
            let Kept { version, text, heard, refused } = keeper.kept();
            (version, text, heard, refused.unwrap_or_default())
        };
        keeper.take(&signed(&account, 2, WATCH)).expect("kept");
        assert_eq!(state(&keeper), (2, WATCH.to_owned(), 2, String::new()));

        let other_robot = SignedPolicy::sign(&DOMAIN, &account, SignerId([8; 32]), 9, WATCH).expect("signs");
        let not_text = SignedPolicy { text: vec![0xff; 4], ..signed(&account, 3, "") };
        for (policy, told) in [
            (signed(&thief, 3, ""), "did not sign"),
            (other_robot, "did not sign"),
            (not_text, "did not sign"),
            (signed(&account, 1, WATCH), "lower than 2"),
            (signed(&account, 2, ""), "same version 2"),
            (signed(&account, 3, "vault.url = \"redis://evil\"\n"), "no 'vault.url'"),
            (signed(&account, 4, "ring.keep = \"much\"\nring.topics = [\"/a\"]\n"), "ring.keep"),
            (signed(&account, 5, "[["), "not valid TOML"),
        ] {
            let heard = policy.version;
            keeper.take(&policy).expect("kept");
            let (version, text, known, refused) = state(&keeper);
            assert_eq!((version, text.as_str(), known), (2, WATCH, heard), "what runs goes on");
            assert!(refused.contains(told), "{told}: {refused}");
        }
        assert_eq!(state(&open()), state(&keeper), "after a restart");
        keeper.take(&signed(&account, 2, WATCH)).expect("kept");
        assert_eq!(state(&keeper), (2, WATCH.to_owned(), 2, String::new()), "heard once more");
        keeper.take(&signed(&account, 6, "")).expect("kept");
        assert_eq!(state(&open()), (6, String::new(), 6, String::new()), "cleared");
    }

    #[test]
    fn each_enrolment_in_a_home_has_its_own_policy() {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let account = EoaSecret::generate().expect("generates");
        let open = |device| PolicyKeeper::of(&ledger, DOMAIN, account.address(), device).expect("opens");
        open(DEVICE).take(&SignedPolicy::sign(&DOMAIN, &account, DEVICE, 5, WATCH).expect("signs")).expect("kept");
        let earlier = Kept { version: 5, text: WATCH.to_owned(), heard: 5, refused: None };
        assert_eq!(open(DEVICE).kept(), earlier);
        let other = SignerId([8; 32]);
        let keeper = open(other);
        assert_eq!(keeper.kept(), Kept::default(), "the policy of the device before is not in force");
        assert_ne!(keeper.told_place(), open(DEVICE).told_place());
        let first = SignedPolicy::sign(&DOMAIN, &account, other, 1, "").expect("signs");
        keeper.take(&first).expect("kept");
        assert_eq!((keeper.kept().version, keeper.kept().refused), (1, None), "the first one is taken up");
        assert_eq!((open(other).kept().version, open(DEVICE).kept()), (1, earlier));
    }
}
