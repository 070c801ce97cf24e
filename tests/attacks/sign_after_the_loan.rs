//! Someone with a device whose loan has ended writes a record, claims that it was captured during the loan, and anchors
//! it from an account of his own: `evidence verify` should say VERIFIED.

use authros::crypto::{ProviderName, SmKeyPair, provider, signer_id};
use authros::model::Timestamp;

use crate::forged_evidence::Scene;
use crate::{Outcome, judge};

#[tokio::test(flavor = "multi_thread")]
async fn sign_after_the_loan() {
    let scene = Scene::new().await;
    let device = SmKeyPair::generate(provider(ProviderName::RustCrypto)).expect("a pair");
    let id = signer_id(&device.public).to_string();
    scene.alice.json(&["robot", "authorise", &id, "--until", "15s"]);
    let within = Timestamp::now();
    let honest = scene.forge(&device, within).await;
    let Outcome::Succeeded(_) = scene.judge(&honest, "no such words") else { panic!("within the loan it may sign") };
    scene.until_expired(&id);
    let folder = scene.forge(&device, within).await;
    judge("sign_after_the_loan", scene.judge(&folder, "had authorised until"));
}
