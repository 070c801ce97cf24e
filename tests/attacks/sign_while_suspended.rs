//! A thief has alice's machine, her account and her signing key; the administrator has suspended her. He signs new
//! records in her name and anchors them from an account of his own: `evidence verify` should say VERIFIED.

use authros::model::Timestamp;

use crate::forged_evidence::Scene;
use crate::{Outcome, judge};

#[tokio::test(flavor = "multi_thread")]
async fn sign_while_suspended() {
    let scene = Scene::new().await;
    let stolen = scene.stolen();
    scene.boss.json(&["chain", "admin", "suspend", &scene.address]);
    let folder = scene.forge(&stolen.keyring.signing, Timestamp::now()).await;
    let outcome = match scene.judge(&folder, "was suspended at block") {
        first @ (Outcome::Succeeded(_) | Outcome::Otherwise(_)) => first,
        // Nor does it count when she may sign again.
        Outcome::Refused(first) => {
            scene.boss.json(&["chain", "admin", "restore", &scene.address]);
            match scene.judge(&folder, "was suspended at block") {
                Outcome::Refused(_) => Outcome::Refused(first),
                Outcome::Succeeded(reached) => Outcome::Succeeded(format!("after the account is restored: {reached}")),
                Outcome::Otherwise(read) => Outcome::Otherwise(format!("after the account is restored: {read}")),
            }
        }
    };
    judge("sign_while_suspended", outcome);
}
