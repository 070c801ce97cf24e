//! To keep evidence on the robot: someone on the network answers uploads with a refusal in clear, which anyone can
//! write, and then goes away again.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use serde_json::Value;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};

use super::support::gate::Gate;
use super::support::{Home, count};
use super::{Outcome, judge};

/// `Malformed`, in clear.
const FORGED: [u8; 7] = [0, 0, 0, 3, 5, 0, 8];
/// This many uploads are answered that way.
const FORGERIES: u32 = 6;
/// Frames of a client longer than this carry records, bytes.
const UPLOAD: u32 = 450;

/// Forwards frames of the client, until one carries records and a forgery is left.
async fn pass(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, left: Arc<AtomicU32>) -> bool {
    loop {
        let Ok(length) = from.read_u32().await else { return false };
        if length > UPLOAD && left.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1)).is_ok()
        {
            return true;
        }
        let mut frame = vec![0; length as usize];
        let passed = async {
            from.read_exact(&mut frame).await?;
            to.write_all(&[&length.to_be_bytes()[..], &frame].concat()).await
        };
        if passed.await.is_err() {
            return false;
        }
    }
}

async fn between(robot: TcpStream, upstream: String, left: Arc<AtomicU32>) {
    let Ok(gateway) = TcpStream::connect(upstream).await else { return };
    let ((from_robot, mut to_robot), (mut from_gateway, to_gateway)) = (robot.into_split(), gateway.into_split());
    tokio::select! {
        forge = pass(from_robot, to_gateway, left) => {
            if forge {
                drop(to_robot.write_all(&FORGED).await);
                drop(to_robot.shutdown().await);
            }
        }
        _ = tokio::io::copy(&mut from_gateway, &mut to_robot) => {}
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_are_answered_in_clear_for_a_while() {
    let gate = Gate::new();
    let alice = gate.home.profile("alice");
    alice.enrol();
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("its address").to_string();
    let (left, upstream) = (Arc::new(AtomicU32::new(0)), gate.gateway.address.clone());
    let forgeries = Arc::clone(&left);
    tokio::spawn(async move {
        while let Ok((robot, _)) = listener.accept().await {
            tokio::spawn(between(robot, upstream.clone(), Arc::clone(&forgeries)));
        }
    });
    let robot = Home::new();
    let file = robot.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
    let enrol = ["robot", "enrol", "--gateway", &address, "--gateway-key", gate.key()];
    alice.json(&[&enrol[..], &["--name", "scout", "--topic", "/robot1/odom", "--out", &file]].concat());
    left.store(FORGERIES, Ordering::SeqCst);
    let agent = robot.authros().with(&["--json", "--robots", "1"]);
    let ended = tokio::task::spawn_blocking(move || agent.spawn(&["robot", "run", &file, "--count", "40"]).wait(180));
    let ended = ended.await.expect("ends");
    let summary: Value = serde_json::from_str(ended.stdout.lines().last().expect("a document")).expect("JSON");
    let (captured, verified) = (count(&summary, "captured"), count(&summary, "verified"));
    assert_eq!(left.load(Ordering::SeqCst), 0, "every forgery was made: {summary}");
    let said = ended.stderr.lines().find(|line| line.contains("unauthenticated message"));
    let outcome = if captured == verified && captured >= 40 {
        let told = format!("{FORGERIES} forged refusals, and all {verified} records were delivered in the same run");
        match said {
            Some(words) => Outcome::Refused(format!("{told}; {words}")),
            None => Outcome::Otherwise(format!("{told}, and nobody was told of them: {ended}")),
        }
    } else {
        Outcome::Succeeded(format!(
            "{} of {captured} records stay in the outbox after the attacker left",
            captured - verified
        ))
    };
    judge("forge_a_refusal", outcome);
}
