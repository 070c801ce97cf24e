//! To use somebody else's disk and anchors: a stranger registers on the open chain, takes a name at the gateway and
//! sends records that its keeper never asked for.

use authros::gateway::{Code, GatewayError};

use super::support::Home;
use super::support::gate::Gate;
use super::support::member::Member;
use super::{Outcome, judge};

#[tokio::test(flavor = "multi_thread")]
async fn a_registered_stranger_takes_a_name_and_uploads() {
    let (gate, away) = (Gate::new(), Home::new());
    let mallory = away.profile("mallory").with(&gate.options());
    mallory.enrol();
    let mallory = Member::of(&away, "mallory", gate.gateway.domain);
    let sent = async {
        let credentials = mallory.allocate(&gate.gateway, "scout-1").await?;
        let mut client =
            authros::gateway::Client::connect(&gate.gateway.endpoint(), &mut gate.gateway.trust(), &credentials)
                .await?;
        let record = mallory.record(&mallory.keyring.signing, "/rubbish", 1, &[7; 1000]);
        client.upload(vec![record]).await
    };
    let outcome = match sent.await {
        Ok(_) => Outcome::Succeeded("a name was bound and a record stored and signed for".to_owned()),
        Err(GatewayError::Refused(code @ Code::NotAdmitted)) => Outcome::Refused(code.to_string()),
        Err(error) => Outcome::Otherwise(error.to_string()),
    };
    judge("use_a_gateway_uninvited", outcome);
}
