//! To read the holdings of a gateway, or have its records handed over, without being a gateway of its fleet: as an owner
//! whom its keeper admitted, as a robot, as a stranger who only says so.

use authros::gateway::{Client, Code, HoldingPlace, Wanted};
use authros::model::{Ranges, RecorderId, TopicId};

use super::support::Home;
use super::support::gate::Gate;
use super::support::member::{Member, connect};
use crate::enrolled_robot::{Robot, Scene, session};
use crate::judge;
use crate::parts::Parts;

/// Asks for all that Commands 20 and 21 give.
async fn ask(parts: &mut Parts, who: &str, client: &mut Client, wanted: Wanted) {
    let told = client.holdings(HoldingPlace::default()).await.map(|held| format!("{} topics told", held.held.len()));
    parts.answered(&format!("{who}: holdings"), told, &[Code::NotAuthorised]);
    let handed = client.hand_over(wanted).await.map(|handed| format!("{} records", handed.records.len()));
    parts.answered(&format!("{who}: records"), handed, &[Code::NotAuthorised]);
    let many = client.hand_over_many(vec![wanted; 3]).await;
    let many = many.map(|many| format!("{} records", many.handed.records.len()));
    parts.answered(&format!("{who}: records of several ranges"), many, &[Code::NotAuthorised]);
}

#[tokio::test(flavor = "multi_thread")]
async fn ask_for_what_a_gateway_holds() {
    let mut parts = Parts::default();
    let (gate, away) = (Gate::new(), Home::new());
    let carol = away.profile("carol").with(&gate.options());
    carol.enrol();
    let carol = Member::of(&away, "carol", gate.gateway.domain);
    gate.home.profile("gateway").json(&["gateway", "admit", &carol.address().to_string()]);
    let credentials = carol.allocate(&gate.gateway, "scout-1").await.expect("admitted");
    let mut client = connect(&gate.gateway, &credentials).await;
    client.upload(vec![carol.record(&carol.keyring.signing, "/odom", 1, b"a message")]).await.expect("stored");
    let (topic_id, _) = carol.topic("/odom");
    let wanted = Wanted { owner: carol.address(), recorder: carol.recorder, topic_id, first: 1, last: 5 };
    // Also her own records: they are handed to gateways only.
    ask(&mut parts, "an admitted owner", &mut client, wanted).await;
    // Absurd requests do not even reach the desk.
    for (first, last) in [(0, 1), (5, 1), (1, u64::MAX), (Ranges::HIGHEST, u64::MAX)] {
        let answer = client.hand_over(Wanted { first, last, ..wanted }).await.map(|_| format!("{first} to {last}"));
        parts.answered("an absurd range", answer, &[Code::Malformed]);
        let answer = client.hand_over_many(vec![wanted, Wanted { first, last, ..wanted }]).await;
        parts.answered(
            "an absurd range behind another",
            answer.map(|_| format!("{first} to {last}")),
            &[Code::Malformed],
        );
    }
    let long = Wanted { first: 1, last: 8_192, ..wanted };
    let answer = client.hand_over_many(vec![long; 2]).await.map(|_| "handed over".to_owned());
    parts.answered("more numbers than are told at once", answer, &[Code::Malformed]);
    drop(client);

    let scene = Scene::new();
    let robot = Robot::enrol(&scene, "scout-1", &[]);
    robot.capture(1);
    let mut client = session(&robot.stolen()).await.expect("it is enrolled");
    let wanted = Wanted { recorder: RecorderId([1; 16]), topic_id: TopicId([2; 16]), ..wanted };
    ask(&mut parts, "a robot", &mut client, wanted).await;
    scene.site.stop("TERM", 20);

    // Without a transport key there is no such Command.
    let mut visitor =
        Client::visit(&gate.gateway.endpoint(), &mut gate.gateway.trust(), &"gateway-1".parse().expect("a name"))
            .await
            .expect("visits");
    let told = visitor.holdings(HoldingPlace::default()).await.map(|_| "holdings".to_owned());
    parts.answered("a visitor", told, &[Code::NotHere]);
    judge("ask_for_what_a_gateway_holds", parts.outcome());
}
