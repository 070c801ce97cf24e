//! Who may use a gateway: owners whom its keeper admits, and at an open one everyone, within quotas.

use authros::gateway::{Code, GatewayError};

use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::{self, Home, text, wait_until};

const TOPIC: &str = "/robot7/log";
const INPUT: i32 = 3;

fn refused(result: Result<impl std::fmt::Debug, GatewayError>) -> Code {
    match result {
        Err(GatewayError::Refused(code)) => code,
        other => panic!("not refused: {other:?}"),
    }
}

/// A profile of another home, registered through the gateway.
fn stranger(gate: &Gate, away: &Home, name: &str) -> Member {
    away.profile(name).with(&gate.options()).enrol();
    Member::of(away, name, gate.gateway.domain)
}

#[tokio::test(flavor = "multi_thread")]
async fn who_may_use_a_gateway_is_its_keepers_choice() {
    let (gate, away) = (Gate::new(), Home::new());
    let carol = stranger(&gate, &away, "carol");
    let keeper = gate.home.authros();
    let owner = carol.address().to_string();
    assert_eq!(refused(carol.allocate(&gate.gateway, "scout").await), Code::NotAdmitted);
    let remedy = format!("`authros gateway allow {owner}`");
    wait_until(20, "the gateway's terminal says what to type", || gate.stderr().contains(&remedy).then_some(()));
    keeper.json(&["gateway", "allow", &owner]);
    let credentials = carol.allocate(&gate.gateway, "scout").await.expect("admitted");
    // Without a site of hers nothing is fetched, which an empty list must not hide.
    let listed = away.profile("carol").with(&gate.options()).run(&["records", "list", "--oldest"]).expect_code(0);
    assert!(listed.stderr.contains("start `authros serve` to fetch what is new"), "{listed}");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let record = |seq| carol.record(&carol.keyring.signing, TOPIC, seq, b"a line");
    robot.upload(vec![record(1)]).await.expect("accepted");
    let left = keeper.json(&["gateway", "deny", &owner]);
    assert!(support::list(&left, "allowed").is_empty(), "{left}");
    assert_eq!(refused(robot.upload(vec![record(2)]).await), Code::NotAdmitted, "in the very same session");
    assert_eq!(refused(robot.missing(&[authros::model::Digest([1; 32])]).await), Code::NotAdmitted);
    assert_eq!(refused(robot.relay("eth_chainId", &serde_json::json!([])).await), Code::NotAdmitted);
    keeper.json(&["gateway", "allow", &owner]);
    robot.upload(vec![record(2)]).await.expect("accepted again");
    let lines = support::list(&keeper.json(&["audit", "list", "--limit", "1000"]), "audit");
    let acts = lines.iter().filter(|line| text(line, "subject") == owner);
    let acts = acts.filter(|line| text(line, "action").starts_with("gateway ")).map(|line| text(line, "outcome"));
    assert_eq!(acts.collect::<Vec<_>>().join(" "), "done begun done begun done begun", "each act has two lines");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_open_gateway_takes_strangers_within_quotas() {
    let settings = "[gateway]\nadmission = \"open\"\nquota_names = 1\nquota_streams = 2\nquota_bytes = \"1MiB\"\n";
    let (gate, away) = (Gate::with(settings), Home::new());
    let carol = stranger(&gate, &away, "carol");
    let credentials = carol.allocate(&gate.gateway, "scout").await.expect("unasked");
    let keeper = gate.home.authros();
    let told = keeper.fails(INPUT, &["gateway", "deny", &carol.address().to_string()]);
    assert!(told.contains("serves it as a guest") && told.contains("gateway.admission"), "{told}");
    let listed = keeper.run(&["gateway", "allowed"]).expect_code(0);
    assert!(listed.stderr.contains("this gateway is open"), "{listed}");
    assert_eq!(refused(carol.allocate(&gate.gateway, "scout-2").await), Code::Quota, "one name");
    let mut robot = connect(&gate.gateway, &credentials).await;
    let record = |topic: &str, seq, length| carol.record(&carol.keyring.signing, topic, seq, &vec![7; length]);
    robot.upload(vec![record("/one", 1, 10), record("/two", 1, 10)]).await.expect("two streams");
    assert_eq!(refused(robot.upload(vec![record("/three", 1, 10)]).await), Code::Quota, "a third");
    robot.upload(vec![record("/one", 2, 10)]).await.expect("those that are there go on");
    assert_eq!(refused(robot.upload(vec![record("/one", 3, 1 << 20)]).await), Code::Quota, "bytes");
    gate.home.authros().json(&["gateway", "allow", &carol.address().to_string()]);
    robot
        .upload(vec![record("/three", 1, 10), record("/one", 3, 1 << 20)])
        .await
        .expect("an admitted owner has no quota");
}
