//! Publishers that a real master lists and that cannot be read: who they are and why, where a person looks.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::io::{Read, Write};
use std::net::TcpListener;

use serde_json::Value;

use crate::support::{Home, Roscore, list, skipped, text, wait_until};

const NO_ROS: &str = "no roscore, rosbag and rostopic in /usr/bin";

/// The slave API of a node that offers no protocol that is asked for, as a publisher of UDPROS alone answers.
fn udp_only() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let uri = format!("http://{}/", listener.local_addr().expect("its address"));
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            let mut request = [0; 8192];
            drop(stream.read(&mut request));
            let body = "<?xml version=\"1.0\"?><methodResponse><params><param><value><array><data><value><int>0</int></value>\
                        <value><string>no supported protocol implementations</string></value><value><int>0</int></value>\
                        </data></array></value></param></params></methodResponse>";
            let head = "HTTP/1.0 200 OK\r\nContent-Type: text/xml\r\nConnection: close\r\nContent-Length: ";
            drop(stream.write_all(format!("{head}{}\r\n\r\n{body}", body.len()).as_bytes()));
        }
    });
    uri
}

fn unreached(topics: &Value, topic: &str) -> Vec<Value> {
    let row = list(topics, "topics").into_iter().find(|row| row["topic"] == topic).expect("it is listed");
    list(&row, "unreached")
}

#[test]
fn each_publisher_that_cannot_be_read_is_named_with_the_reason() {
    let Some(roscore) = Roscore::start() else { skipped!(NO_ROS) };
    roscore.register("/ghost", "/ghostonly", "http://robot-without-dns.invalid:40001/");
    roscore.register("/udp", "/udponly", &udp_only());
    let home = Home::new();
    let authros = home.authros().with(&["--ros-master", &roscore.uri()]);
    let site = authros.serve(&home);

    let captured = authros.with(&["--json"]).run(&[
        "capture",
        "--topic",
        "/ghostonly",
        "--topic",
        "/udponly",
        "--topic",
        "/nobody",
        "--for",
        "8s",
    ]);
    let captured = captured.expect_code(8);
    let summary = captured.document();
    let told = &captured.stderr;
    let of = |topic: &str| {
        let found = list(&summary, "topics").into_iter().find(|row| row["topic"] == topic).expect("in the summary");
        list(&found, "unreached")
    };
    assert_eq!(text(&of("/ghostonly")[0], "node"), "/ghost", "{summary}");
    assert_eq!(text(&of("/ghostonly")[0], "place"), "robot-without-dns.invalid:40001");
    assert!(text(&of("/ghostonly")[0], "reason").contains("resolve"), "{summary}");
    assert!(text(&of("/udponly")[0], "reason").contains("it offers no TCPROS"), "{summary}");
    assert!(told.contains("/ghost at robot-without-dns.invalid:40001") && told.contains("no TCPROS"), "{told}");
    assert!(told.contains("nothing arrived on /nobody; check its name"), "only that one has no publisher: {told}");

    authros.run(&["topics", "watch", "/ghostonly"]).expect_code(0);
    wait_until(30, "the list tells it, too", || {
        let topics = authros.json(&["topics", "list"]);
        unreached(&topics, "/ghostonly").iter().any(|one| one["node"] == "/ghost").then_some(())
    });
    let shown = authros.run(&["topics", "list"]).expect_code(0).stdout;
    assert!(shown.contains("/ghostonly is not read from /ghost at"), "{shown}");
    drop(site);
}
