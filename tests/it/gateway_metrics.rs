//! Figures of a gateway and of a robot's agent: the terms of the balance, who was last seen when, what was refused, the
//! state of the connection.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use serde_json::Value;

use super::metrics::{figures, promtool, value};
use crate::support::{Home, count, free_port, text, wait_until};

const TOPIC: &str = "/robot1/odom";

/// The captured count of an account, and the sum of the other terms.
pub(super) fn law(told: &str, owner: &str) -> (f64, f64) {
    let terms = ["verified", "pending", "right_ended", "quarantined", "dropped", "tampered"]
        .map(|state| value(told, &format!("authros_records{{owner=\"{owner}\",state=\"{state}\"}}")));
    (value(told, &format!("authros_records_captured_total{{owner=\"{owner}\"}}")), terms.iter().sum())
}

/// Values of families that every site has.
fn has_families(told: &str, names: &[&str]) {
    for name in names {
        let begins = |line: &str| line.strip_prefix(name).is_some_and(|rest| rest.starts_with(['{', ' ']));
        assert!(told.lines().any(begins), "no {name}:\n{told}");
    }
}

const EVERYWHERE: [&str; 16] = [
    "authros_build_info",
    "authros_records_captured_total",
    "authros_records",
    "authros_records_conserved",
    "authros_losses_total",
    "authros_gaps_untold",
    "authros_oldest_unanchored_age_seconds",
    "authros_audit_lines_total",
    "authros_audit_unanchored_age_seconds",
    "authros_clock_ahead_seconds",
    "authros_queue_messages",
    "authros_disk_free_bytes",
    "authros_disk_reserve_bytes",
    "authros_part_up",
    "authros_latency_seconds_count",
    "authros_alerts",
];

#[test]
fn a_gateway_and_an_agent_have_figures_of_their_own() {
    let (home, robot) = (Home::new(), Home::new());
    let (port, at_gateway, at_robot) = (free_port(), free_port(), free_port());
    let listen = format!("127.0.0.1:{port}");
    let keeper = home.profile("keeper").with(&["--json"]);
    let serving = keeper.with_variable("AUTHROS_METRICS_LISTEN", &format!("127.0.0.1:{at_gateway}"));
    let mut gateway = serving.spawn(&["gateway", "serve", "--listen", &listen]);
    let said = gateway.wait_for_text("\"gateway\"", 120);
    let line = said.lines().find(|line| line.contains("\"gateway\"")).expect("a document");
    let key = text(&serde_json::from_str::<Value>(line).expect("JSON")["gateway"], "gateway");
    let owner = home.profile("alice");
    let account = owner.enrol();
    let short: String = account.trim_start_matches("0x").chars().take(8).collect();
    let enrolment = robot.root().join("robot.enrolment").to_str().expect("UTF-8").to_owned();
    let arguments =
        ["robot", "enrol", "--gateway", &listen, "--gateway-key", &key, "--name", "scout", "--out", &enrolment];
    let device = text(&owner.json(&[&arguments[..], &["--topic", TOPIC]].concat()), "device");

    let running = robot.authros().with(&["--json"]);
    let running = running.with_variable("AUTHROS_METRICS_LISTEN", &format!("127.0.0.1:{at_robot}"));
    let agent = running.spawn(&["robot", "run", &enrolment, "--robots", "1"]);
    let of_agent = wait_until(120, "verified records in the agent's figures", || {
        let line = format!("authros_records{{owner=\"{short}\",state=\"verified\"}}");
        figures(at_robot).filter(|told| told.contains(&line) && value(told, &line) >= 5.0)
    });
    let of_gateway = wait_until(60, "the robot's records in the gateway's figures", || {
        let line = format!("authros_records{{owner=\"{short}\",state=\"verified\"}}");
        figures(at_gateway).filter(|told| told.contains(&line) && value(told, &line) >= 5.0)
    });
    for (who, told) in [("agent", &of_agent), ("gateway", &of_gateway)] {
        has_families(told, &EVERYWHERE);
        let (captured, terms) = law(told, &short);
        assert!(captured >= 5.0 && (captured - terms).abs() < 0.5, "{who}: {captured} is not {terms}");
        assert!((value(told, &format!("authros_records_conserved{{owner=\"{short}\"}}")) - 1.0).abs() < 0.5, "{who}");
        promtool(&["check", "metrics"], told);
        for name in [TOPIC, "odom", "scout", "alice", "keeper", &account, &device] {
            assert!(!told.to_lowercase().contains(&name.to_lowercase()), "{name} is in the figures of the {who}");
        }
    }
    has_families(&of_agent, &["authros_latency_seconds_bucket", "authros_stage_busy_seconds_total"]);
    assert!((value(&of_agent, "authros_part_up{part=\"gateway\"}") - 1.0).abs() < 0.5, "the line to the gateway");
    let here = ["authros_chain_block_height", "authros_last_block_age_seconds", "authros_lane_paused"];
    has_families(&of_gateway, &here);
    let begins: String = device.chars().filter(char::is_ascii_hexdigit).take(8).collect();
    let seen = format!("authros_robot_last_seen_age_seconds{{robot=\"{begins}\"}}");
    assert!(value(&of_gateway, &seen) < 3600.0);
    assert!(value(&of_gateway, "authros_gateway_connections ") >= 1.0);

    // Invalid frames are refused, and the refusal is counted by its code.
    drop(std::io::Write::write_all(&mut std::net::TcpStream::connect(&listen).expect("a line"), &[0xff; 200]));
    wait_until(30, "the refusal in the figures", || {
        figures(at_gateway).filter(|told| told.contains("authros_gateway_refused_total{code=\""))
    });
    gateway.stop("KILL", 10);
    wait_until(60, "the gateway's end in the agent's figures", || {
        let told = figures(at_robot)?;
        told.contains("authros_part_up{part=\"gateway\"} 0\n").then_some(())
    });
    let summary = agent.stop("TERM", 30).expect_code(0).stdout;
    let summary: Value = serde_json::from_str(summary.lines().last().expect("a document")).expect("JSON");
    assert!(count(&summary, "captured") >= 5, "{summary}");
}
