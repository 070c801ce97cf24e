//! `robots` and `devices`: what is asked of enrolled robots, their policies, and the devices on loan.

use std::path::{Path, PathBuf};
use std::{collections::BTreeMap, io::Read as _};

use authros_output::{Output, table};
use clap::{Args, Subcommand};

use super::parse;
use super::plan::Plan;
use super::show::{Question, or_dash};
use crate::crypto::keyfile::{load_sm2, sm2_public_from_pem};
use crate::crypto::{LONGEST_POLICY, ProviderName, SmKeyPair, provider, signer_id};
use crate::model::{PublicKey, Sampling, SignerId, Timestamp, TopicRule, bytes::unhex, clean};
use crate::service::reply::{
    DeviceRow, PolicyRow, PolicyView, RingPullView, RobotRow, RobotTopicRow, RobotView, coverage_legend,
};
use crate::service::{Failure, command, failure::input};

/// `robots …`
#[derive(Debug, Subcommand)]
pub enum RobotsVerb {
    /// Fetch unwatched data from a robot's ring, for a time span; it arrives like other records
    Pull {
        /// Its name, or the beginning of its device's id
        robot: String,
        /// Start: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME", allow_hyphen_values = true, required_unless_present = "incident")]
        since: Option<String>,
        /// End; same format [default: now]
        #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
        until: Option<String>,
        /// Only these topics; * matches anything but /, ** anything [default: all of the ring]
        #[arg(long = "topic", visible_alias = "topics", value_name = "PATTERN", num_args = 1.., value_delimiter = ',')]
        topics: Vec<String>,
        /// Take the span and topics of this incident unless given
        #[arg(long, value_name = "NAME")]
        incident: Option<String>,
    },
    /// List the enrolled robots: last seen, waiting and lost records, policy
    List,
    /// Show one robot: policy, gateway, topics, losses
    Show {
        /// Its name, or the beginning of its device's id
        robot: String,
    },
    /// Show, set or clear a robot's policy, which says what it captures; applied at its next connection
    Policy {
        /// Its name, or the beginning of its device's id
        robot: String,
        /// Set it: a TOML file with [[watch]], [[topic]], ring.keep and ring.topics; - for standard input
        #[arg(long, value_name = "FILE", conflicts_with_all = ["clear", "show"])]
        set: Option<PathBuf>,
        /// Clear it: the robot's own settings apply again
        #[arg(long, conflicts_with = "show")]
        clear: bool,
        /// Show it [default]
        #[arg(long)]
        show: bool,
    },
}

pub fn plan(verb: RobotsVerb, output: &Output) -> Result<Plan, Failure> {
    let question: Question = match verb {
        RobotsVerb::Pull { robot, since, until, topics, incident } => {
            let times = parse::Times::now(output);
            command::PullRing {
                name: robot,
                since: times.since(since.as_deref())?,
                until: times.until(until.as_deref())?,
                topics: parse::values(&topics)?,
                incident: parse::optional(incident.as_deref())?,
            }
            .into()
        }
        RobotsVerb::List => command::ListRobots.into(),
        RobotsVerb::Policy { robot, clear: true, .. } => {
            command::SetRobotPolicy { name: robot, text: String::new() }.into()
        }
        RobotsVerb::Policy { robot, set: Some(file), .. } => {
            command::SetRobotPolicy { name: robot, text: policy_of(&file)? }.into()
        }
        RobotsVerb::Show { robot } => command::ShowRobot { name: robot }.into(),
        // The default.
        RobotsVerb::Policy { robot, show: _show, .. } => command::ShowRobot { name: robot }.into(),
    };
    Ok(Plan::unlocked(question))
}

/// Reads at most one byte more than a policy may have.
fn policy_of(file: &Path) -> Result<String, Failure> {
    let shown = clean(&file.display().to_string(), 200);
    let unread = |error: std::io::Error| input(format!("{shown} cannot be read: {error}"));
    let mut text = String::new();
    let most = LONGEST_POLICY as u64 + 1;
    let read = match file.as_os_str() == "-" {
        true => std::io::stdin().take(most).read_to_string(&mut text),
        false => std::fs::File::open(file).and_then(|file| file.take(most).read_to_string(&mut text)),
    };
    read.map_err(unread)?;
    if text.trim().is_empty() {
        let advice = "`robot policy ROBOT --clear` gives a robot back its own settings";
        return Err(input(format!("{shown} is empty; {advice}")));
    }
    Ok(text)
}

pub fn all(robots: &[RobotRow]) -> String {
    if robots.is_empty() {
        return "no robots; enrol one with `authros robot enrol`".to_owned();
    }
    let row = |robot: &RobotRow| {
        [
            robot.name.to_string(),
            or_dash(robot.last_seen),
            or_dash(robot.address.as_ref()),
            robot.waiting.to_string(),
            robot.lost.to_string(),
            or_dash(Some(robot.wanted).filter(|version| *version > 0)),
            or_dash(robot.running),
            robot.standing.clone(),
            robot.drift_since.map_or_else(String::new, |since| format!("out of date since {since}")),
        ]
    };
    let head = ["robot", "last seen", "gateway", "waiting", "lost", "wanted", "runs", "policy", ""];
    table(&head, robots.iter().map(row))
}

pub fn one(view: &RobotView) -> String {
    let row = &view.row;
    let wanted = match (row.wanted, view.set_at) {
        (0, _) => "no policy was set".to_owned(),
        (version, at) => format!("policy {version}, set {}: {}", or_dash(at), row.standing),
    };
    let mut lines = vec![
        format!("robot '{}', device {}", row.name, row.device),
        format!("last seen {}; {} of its records wait here", or_dash(row.last_seen), row.waiting),
        wanted,
    ];
    lines.extend(row.running.map(|running| format!("it runs version {running}")));
    lines.extend(row.drift_since.map(|since| format!("out of date since {since}")));
    lines.extend(view.refused.iter().map(|why| format!("it refused: {why}")));
    lines.extend(view.overruled.iter().map(|what| format!("overridden on the robot: {what}")));
    lines.extend(view.gateway.iter().flat_map(|one| &one.addresses).map(|address| format!("gateway {address}")));
    let cells = |topic: &RobotTopicRow| {
        let counts = [topic.records, topic.verified, topic.waiting, topic.lost].map(|count| count.to_string());
        let ends = [topic.first, topic.last].map(|at| or_dash(at.map(Timestamp::in_milliseconds)));
        [vec![topic.topic.clone()], counts.to_vec(), ends.to_vec(), vec![topic.strip.clone()]].concat()
    };
    if !view.topics.is_empty() {
        let head = ["topic", "messages", "verified", "waiting", "lost", "first", "last", "coverage"];
        lines.push(table(&head, view.topics.iter().map(cells)));
    }
    lines.extend(view.covered.map(|span| {
        let signs: String = view.topics.iter().map(|topic| topic.strip.as_str()).collect();
        let (since, until) = (span.since.in_milliseconds(), span.until.in_milliseconds());
        format!("coverage from {since} to {until}, {} per sign: {}", span.part(), coverage_legend(&signs))
    }));
    if !view.policy.is_empty() {
        lines.push(format!("\n{}", view.policy.trim_end()));
    }
    lines.join("\n")
}

pub fn pulled(view: &RingPullView) -> String {
    let topics = if view.topics.is_empty() { "all its topics".to_owned() } else { view.topics.join(", ") };
    format!(
        "requested from robot '{}': what its ring has of {topics} from {} to {}; at its next connection it sends what \
         is still there",
        view.robot, view.since, view.until
    )
}

/// Longest key file read, bytes.
const LONGEST: u64 = 16 * 1024;

/// `devices …`
#[derive(Debug, Subcommand)]
pub enum DevicesVerb {
    /// Authorise a device to sign for this profile
    Lend {
        /// Id of the device (64 hex), or the file of its SM2 key (public PEM, or private 0600)
        #[arg(value_name = "ID_OR_KEYFILE")]
        device: String,
        /// End of the authorisation: 30d, 18:00, "tomorrow 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME")]
        until: Option<String>,
    },
    /// Revoke a device: it can no longer sign or read, its sessions end, and a new epoch begins
    Recall {
        /// Id of the device or its first characters, its fingerprint, or the name it was enrolled under
        #[arg(value_name = "ID")]
        device: String,
    },
    /// The topics an enrolled robot may record
    #[command(subcommand)]
    Topics(TopicsVerb),
    /// Where an enrolled robot finds its gateway
    #[command(subcommand)]
    Addresses(AddressesVerb),
    /// List authorised and revoked devices
    List,
}

/// `devices topics …`
#[derive(Debug, Subcommand)]
pub enum TopicsVerb {
    /// Give a robot the keys of more topics; it picks them up automatically
    Add {
        /// Name of the robot, or the device's id, its first characters, or its fingerprint
        #[arg(value_name = "DEVICE")]
        device: String,
        /// The topics
        #[arg(value_name = "TOPIC", required = true)]
        topics: Vec<String>,
    },
}

/// `devices addresses …`
#[derive(Debug, Subcommand)]
pub enum AddressesVerb {
    /// Give a robot a further address of its gateway; applied at its next connection
    Add {
        /// Name of the robot, or the device's id, its first characters, or its fingerprint
        #[arg(value_name = "DEVICE")]
        device: String,
        /// The address
        #[arg(value_name = "HOST:PORT")]
        address: String,
    },
}

pub fn question(verb: &DevicesVerb, output: &Output) -> Result<Question, Failure> {
    Ok(match verb {
        DevicesVerb::Lend { device, until } => {
            let until = parse::Times::now(output).end(until.as_deref())?;
            command::LendDevice { device: device_of(device)?, until }.into()
        }
        DevicesVerb::Recall { device } => command::RecallDevice { device: device.clone() }.into(),
        DevicesVerb::Topics(TopicsVerb::Add { device, topics }) => {
            command::AddDeviceTopics { device: device.clone(), topics: parse::values(topics)? }.into()
        }
        DevicesVerb::Addresses(AddressesVerb::Add { device, address }) => {
            command::AddDeviceAddress { device: device.clone(), address: address.clone() }.into()
        }
        DevicesVerb::List => command::ListDevices.into(),
    })
}

fn device_of(text: &str) -> Result<SignerId, Failure> {
    let path = Path::new(text);
    if path.is_file() {
        return Ok(signer_id(&public_key(path)?));
    }
    unhex(text).and_then(|bytes| SignerId::from_slice(&bytes)).ok_or_else(|| {
        let advice = "a fingerprint alone is not enough to authorise a device; give the key file";
        input(format!("give a device as 64 hex characters or as the file of its SM2 key; {advice}"))
    })
}

fn public_key(path: &Path) -> Result<PublicKey, Failure> {
    let broken = |error: std::io::Error| input(format!("{}: {error}", path.display()));
    if std::fs::metadata(path).map_err(broken)?.len() > LONGEST {
        return Err(input(format!("{} is too long to be a key", path.display())));
    }
    let bytes = std::fs::read(path).map_err(broken)?;
    if String::from_utf8_lossy(&bytes).contains("BEGIN PUBLIC KEY") {
        return Ok(sm2_public_from_pem(&String::from_utf8_lossy(&bytes))?);
    }
    let secret = load_sm2(path)?;
    Ok(SmKeyPair::from_secret(provider(ProviderName::default()), secret)?.public)
}

pub fn devices(rows: &[DeviceRow]) -> String {
    let row = |row: &DeviceRow| {
        [
            row.device.to_string(),
            row.fingerprint.clone(),
            row.state.clone(),
            row.from.to_string(),
            or_dash(row.until),
            or_dash(row.recalled),
        ]
    };
    let head = ["device", "fingerprint", "state", "from block", "until", "revoked at"];
    table(&head, rows.iter().map(row))
}

/// Bytes a second from which a rate is suggested.
const HEAVY: f64 = 500_000.0;
/// Messages a second from which sampling is suggested.
const FAST: f64 = 50.0;
/// The rate suggested for heavy topics, messages a second.
const CALM: f64 = 5.0;

/// `topics rules …`
#[derive(Debug, Args)]
pub struct PolicyArguments {
    /// Observe the live topics and print draft rules for config.toml
    #[arg(long)]
    pub learn: bool,
    /// How long to observe: 5s, 1m
    #[arg(long = "for", value_name = "TIME", default_value = "5s", requires = "learn")]
    pub duration: String,
}

pub fn policy(arguments: &PolicyArguments) -> Result<Question, Failure> {
    let milliseconds = u64::try_from(parse::duration(&arguments.duration)?.as_millis()).unwrap_or(u64::MAX);
    Ok(if arguments.learn { command::LearnPolicy { milliseconds }.into() } else { command::ShowPolicy.into() })
}

pub fn show(view: &PolicyView, output: &Output) {
    if view.learned {
        let draft = draft(&view.topics);
        output.result(&serde_json::json!({ "draft": draft, "topics": view.topics }), || draft.clone());
    } else {
        output.result(view, || text(view));
    }
}

fn text(view: &PolicyView) -> String {
    let row = |row: &PolicyRow| {
        let rule = row.rule.as_ref();
        [
            row.topic.clone(),
            or_dash(rule.map(|rule| format!("{} (line {})", rule.pattern, rule.line))),
            terms(rule, row.sampling),
            if row.watched { "watched" } else { "" }.to_owned(),
            row.left_out.to_string(),
        ]
    };
    let mut text = table(&["topic", "rule", "kept", "", "skipped"], view.topics.iter().map(row));
    for rule in &view.idle {
        text.push_str(&format!("\nno topic now: {} (line {})", rule.pattern, rule.line));
    }
    text
}

fn terms(rule: Option<&TopicRule>, sampling: Sampling) -> String {
    let mut terms = Vec::new();
    terms.extend(rule.and_then(|rule| rule.type_name.as_ref()).map(|name| format!("only {name}")));
    terms.extend((!sampling.is_all()).then(|| sampling.to_string()));
    terms.extend(rule.iter().flat_map(|rule| &rule.tags).map(|(key, value)| format!("{key}={value}")));
    terms.extend(rule.and_then(|rule| rule.retention).map(|seconds| format!("kept {}", span(seconds))));
    if terms.is_empty() { "everything".to_owned() } else { terms.join(", ") }
}

fn span(seconds: u64) -> String {
    match seconds {
        whole if whole % 86_400 == 0 => format!("{} d", whole / 86_400),
        whole if whole % 3_600 == 0 => format!("{} h", whole / 3_600),
        whole if whole % 60 == 0 => format!("{} min", whole / 60),
        other => format!("{other} s"),
    }
}

/// Topics that differ only in numbers share a rule.
fn draft(topics: &[PolicyRow]) -> String {
    let mut groups: BTreeMap<(String, Option<&str>), Vec<&PolicyRow>> = BTreeMap::new();
    for row in topics {
        groups.entry((without_numbers(&row.topic), row.type_name.as_deref())).or_default().push(row);
    }
    let mut draft = String::from("# A draft, learned from the live topics: copy what you need into config.toml.\n");
    for ((pattern, type_name), rows) in groups {
        let pattern = if let [only] = rows[..] { &only.topic } else { &pattern };
        if pattern.parse::<crate::model::TopicPattern>().is_err() {
            continue;
        }
        draft.push('\n');
        rows.iter().for_each(|row| draft.push_str(&observed(row)));
        draft.push_str(&format!("[[topic]]\nmatch = \"{pattern}\"\n"));
        if let Some(name) = type_name.filter(|name| name.parse::<crate::model::TypeName>().is_ok()) {
            draft.push_str(&format!("type = \"{name}\"\n"));
        }
        draft.push_str(&suggestions(&rows));
    }
    draft
}

fn observed(row: &PolicyRow) -> String {
    let (Some(hz), Some(bytes)) = (row.hz, row.bytes_per_second) else {
        return format!("# {}: nothing arrived\n", row.topic);
    };
    let largest = or_dash(row.largest);
    format!("# {}: {hz:.1} messages/s, {:.1} KB/s, largest {largest} bytes\n", row.topic, bytes / 1000.0)
}

fn suggestions(rows: &[&PolicyRow]) -> String {
    let most = |each: fn(&PolicyRow) -> Option<f64>| rows.iter().filter_map(|row| each(row)).fold(0.0, f64::max);
    let (hz, bytes) = (most(|row| row.hz), most(|row| row.bytes_per_second));
    if bytes >= HEAVY && hz > CALM {
        format!("rate = {CALM:.1} # heavy\n")
    } else if hz >= FAST {
        format!("# every = {} # fast: about 10 messages/s would remain\n", (hz / 10.0).round().max(2.0))
    } else {
        String::new()
    }
}

fn without_numbers(topic: &str) -> String {
    let mut pattern = String::with_capacity(topic.len());
    for letter in topic.chars() {
        match letter {
            '0'..='9' if pattern.ends_with('*') => {}
            '0'..='9' => pattern.push('*'),
            other => pattern.push(other),
        }
    }
    pattern
}

#[cfg(test)]
mod devices_tests {
    use super::*;

    #[test]
    fn a_device_is_named_by_its_id_or_its_key() {
        let home = tempfile::tempdir().expect("folder");
        let pair = SmKeyPair::generate(provider(ProviderName::default())).expect("pair");
        let id = signer_id(&pair.public);
        let public = home.path().join("device.pem");
        std::fs::write(&public, crate::crypto::keyfile::sm2_public_pem(&pair.public).expect("pem")).expect("written");
        let private = home.path().join("device.key");
        let pem = crate::crypto::keyfile::sm2_pem(&pair.secret).expect("pem");
        crate::crypto::private_file::create_private(&private, pem.as_bytes()).expect("written");
        for name in [id.to_string(), format!("0x{id}"), public.display().to_string(), private.display().to_string()] {
            assert_eq!(device_of(&name).ok(), Some(id), "{name}");
        }
        assert!(device_of(&id.to_string()[..32]).is_err() && device_of("nowhere.pem").is_err());
        std::fs::write(&public, "no key").expect("written");
        assert!(device_of(&public.display().to_string()).is_err());
    }
}

#[cfg(test)]
mod policy_tests {
    use super::*;

    fn row(topic: &str, hz: f64, bytes: f64) -> PolicyRow {
        PolicyRow {
            topic: topic.into(),
            type_name: Some("sensor_msgs/Imu".into()),
            watched: false,
            sampling: Sampling::default(),
            rule: None,
            left_out: 0,
            hz: Some(hz),
            bytes_per_second: Some(bytes),
            largest: Some(320),
        }
    }

    #[test]
    fn spans_are_told_in_the_largest_unit_that_is_whole() {
        let told = [20, 90, 120, 7_200, 172_800].map(span);
        assert_eq!(told, ["20 s", "90 s", "2 min", "2 h", "2 d"]);
    }

    #[test]
    fn a_draft_is_a_file_that_can_be_used() {
        let hostile = row("/evil\"\n[x]", 1.0, 1.0);
        let text = draft(&[row("/robot1/imu", 100.0, 30_000.0), row("/robot2/imu", 99.0, 30_000.0), hostile]);
        let text = format!("{text}{}", draft(&[row("/scan", 40.0, 900_000.0)]));
        let file = Some((std::path::Path::new("config.toml"), text.as_str()));
        let config = crate::config::Config::resolve(&|_| None, &|_| None, file).expect(&text);
        let rule = config.topic_rules.of("/robot7/imu").expect("a rule");
        assert_eq!((rule.pattern.as_str(), rule.rate), ("/robot*/imu", None));
        assert_eq!(config.topic_rules.of("/scan").expect("a rule").rate, Some(5_000));
        assert_eq!(config.topic_rules.0.len(), 2, "{text}");
    }
}
