//! Alerts reach a webhook that refuses four times and hangs once: each begins once and ends once, across a kill of the
//! site, signed, and naming nobody.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::Value;
use support::{Authros, Home, Running, count, free_port, list, skipped, system_program, text, wait_until};

const SECRET: &str = "0123456789abcdef0123456789abcdef";

/// A request to a server: the head, and the body.
type Asked = (String, Vec<u8>);

/// A server that refuses at first, then hangs once, then accepts everything.
pub(crate) struct Webhook {
    port: u16,
    asked: Arc<Mutex<Vec<Asked>>>,
}

impl Webhook {
    pub(crate) fn start(refusals: usize) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("its address").port();
        let asked = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&asked);
        std::thread::spawn(move || {
            let mut held = Vec::new();
            for (number, mut stream) in listener.incoming().flatten().enumerate() {
                let Some(request) = request(&mut stream) else { continue };
                if number < refusals {
                    answer(&mut stream, "503 Service Unavailable");
                } else if number == refusals && refusals > 0 {
                    held.push(stream);
                } else {
                    kept.lock().unwrap_or_else(PoisonError::into_inner).push(request);
                    answer(&mut stream, "200 OK");
                }
            }
        });
        Self { port, asked }
    }

    pub(crate) fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    fn taken(&self) -> Vec<Asked> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Accepted bodies with this state about this alert.
    pub(crate) fn told(&self, state: &str, key: &str) -> Vec<Value> {
        let bodies = self.taken().into_iter().map(|(_, body)| serde_json::from_slice(&body).expect("JSON"));
        bodies.filter(|body: &Value| body["state"] == state && body["alert"]["key"] == key).collect()
    }
}

fn request(stream: &mut TcpStream) -> Option<Asked> {
    let mut bytes = Vec::new();
    let head = loop {
        let mut some = [0; 4096];
        let length = stream.read(&mut some).ok().filter(|length| *length > 0)?;
        bytes.extend(&some[..length]);
        if let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") {
            break end + 4;
        }
    };
    let text = String::from_utf8_lossy(&bytes[..head]).into_owned();
    let length: usize = header(&text, "content-length").parse().expect("a length");
    let mut body = bytes.split_off(head);
    while body.len() < length {
        let mut some = [0; 4096];
        let more = stream.read(&mut some).ok().filter(|length| *length > 0)?;
        body.extend(&some[..more]);
    }
    Some((text, body))
}

fn header(head: &str, name: &str) -> String {
    let named = head.lines().filter_map(|line| line.split_once(':')).find(|(key, _)| key.eq_ignore_ascii_case(name));
    named.map_or_else(String::new, |(_, value)| value.trim().to_owned())
}

fn answer(stream: &mut TcpStream, status: &str) {
    let text = format!("HTTP/1.1 {status}\r\nContent-Length: 2\r\nConnection: close\r\n\r\nok");
    // The client may have gone.
    drop(stream.write_all(text.as_bytes()));
}

/// By an independent implementation.
fn signature(python: &Path, time: &str, body: &[u8]) -> String {
    let script = "import sys, hmac, hashlib\n\
                  print(hmac.new(sys.argv[1].encode(), sys.stdin.buffer.read(), hashlib.sha256).hexdigest())";
    let mut command = Command::new(python);
    let mut child =
        command.args(["-c", script, SECRET]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("python3");
    let signed = [time.as_bytes(), b".", body].concat();
    child.stdin.take().expect("stdin").write_all(&signed).expect("given");
    let told = child.wait_with_output().expect("it ends").stdout;
    format!("sha256={}", String::from_utf8_lossy(&told).trim())
}

fn watched(home: &Home, url: &str, disk: &str) -> Authros {
    home.authros()
        .with(&["--robots", "0"])
        .with_variable("AUTHROS_ALERTS_WEBHOOK", url)
        .with_variable("AUTHROS_ALERTS_SECRET", &home.file("secret", SECRET, 0o600))
        .with_variable("AUTHROS_ALERTS_EVERY", "1")
        .with_variable("AUTHROS_ALERTS_DISK", disk)
}

#[test]
fn an_alert_arrives_once_begun_and_once_over_at_a_webhook_that_refuses_and_hangs() {
    let Some(python) = system_program("python3") else { skipped!("no python3") };
    let home = Home::new();
    let webhook = Webhook::start(4);
    // No disk has this much room.
    let full = watched(&home, &webhook.url(), "1000000GiB");
    let mut site = full.serve(&home);
    wait_until(120, "the alert, refused four times and hung once", || webhook.told("begun", "disk").pop());
    let standing = full.json(&["alerts", "list"]);
    assert!(list(&standing, "alerts").iter().any(|alert| alert["key"] == "disk"), "{standing}");
    site.expect_running();
    // It does not begin again with another process, not even after a kill.
    site.stop("KILL", 20);
    let again = full.with_variable("AUTHROS_DISK_RESERVE", "65MiB");
    let site = again.serve(&home);
    wait_until(60, "a look of the second process, whose words differ", || {
        let standing = again.json(&["alerts", "list"]).to_string();
        standing.contains("below 65 MiB").then_some(())
    });
    let tested = full.json(&["alerts", "test"]);
    assert_eq!(text(&tested, "text"), "200: ok", "{tested}");
    site.stop("INT", 20).expect_code(0);
    let roomy = watched(&home, &webhook.url(), "1KiB");
    let site = roomy.serve(&home);
    wait_until(120, "the end of the alert", || webhook.told("resolved", "disk").pop());
    wait_until(30, "no alert about the disk", || {
        list(&roomy.json(&["alerts", "list"]), "alerts").iter().all(|alert| alert["key"] != "disk").then_some(())
    });
    site.stop("INT", 20).expect_code(0);
    assert_eq!((webhook.told("begun", "disk").len(), webhook.told("resolved", "disk").len()), (1, 1));
    let account = text(&home.authros().json(&["identity", "show"]), "address").to_lowercase();
    for (head, body) in webhook.taken() {
        let told = String::from_utf8_lossy(&body).to_lowercase();
        assert!(!told.contains(&account) && !told.contains("default"), "{told}");
        let wanted = signature(&python, &header(&head, "x-authros-time"), &body);
        assert_eq!(header(&head, "x-authros-signature"), wanted);
    }
}

#[test]
fn alerts_test_says_what_came_back_or_that_nobody_is_there() {
    let home = Home::new();
    let nobody = home.authros().with(&["--robots", "0"]);
    nobody.json(&["identity", "create"]);
    assert!(text(&nobody.json(&["alerts", "list"]), "told").contains("alerts.webhook"));
    assert!(nobody.fails(3, &["alerts", "test"]).contains("alerts.webhook"));
    let gone = watched(&home, &format!("http://127.0.0.1:{}/", free_port()), "0");
    assert!(gone.fails(4, &["alerts", "test"]).contains("cannot be reached"));
    let open = home.file("open", SECRET, 0o644);
    gone.with_variable("AUTHROS_ALERTS_SECRET", &open).fails(3, &["config", "check"]);
    let settings = home.file("site/config.toml", "[alerts]\ncommand = [\"/bin/true\"]\n", 0o600);
    let page = home.authros();
    assert_eq!(text(&page.json(&["alerts", "test"]), "place"), "command /bin/true");
    home.file("site/config.toml", "[alerts]\ncommand = [\"/bin/true\"]\n", 0o622);
    assert!(page.fails(3, &["alerts", "test"]).contains("chmod go-w"), "{settings}");
}

#[test]
fn what_stands_is_shown_where_nobody_is_to_be_told() {
    let home = Home::new();
    let port = free_port();
    let authros = home.authros().with(&["--robots", "0"]).with_variable("AUTHROS_ALERTS_EVERY", "1");
    let full = authros.with_variable("AUTHROS_ALERTS_DISK", "1000000GiB");
    let site = full.with_variable("AUTHROS_METRICS_LISTEN", &format!("127.0.0.1:{port}")).serve(&home);
    let alert = wait_until(60, "the alert in the status", || {
        list(&authros.json(&["status"]), "alerts").into_iter().find(|alert| alert["key"] == "disk")
    });
    assert!(text(&alert, "begun").starts_with("20"), "{alert}");
    let listed = authros.json(&["alerts", "list"]);
    assert_eq!(list(&listed, "alerts").len(), 1, "{listed}");
    let people = authros.run(&["status"]).stdout;
    assert!(people.contains("alert since") && people.contains("free on the home's disk"), "{people}");
    wait_until(30, "the alert in the figures", || {
        let figures = super::metrics::figures(port)?;
        figures.contains("authros_alerts{rule=\"disk\"} 1\n").then_some(())
    });
    assert!(!home.path().join("alerts.queue").exists(), "nothing is kept for nobody");
    site.stop("INT", 20).expect_code(0);
}

#[test]
fn a_grant_is_an_alert_when_a_tenth_of_it_is_left_and_not_when_it_is_made() {
    let home = Home::new();
    let webhook = Webhook::start(0);
    let alice = watched(&home, &webhook.url(), "0").with_variable("AUTHROS_ALERTS_GRANT_ENDS", "3w");
    let site = alice.serve(&home);
    let bob = home.profile("bob").enrol();
    alice.json(&["grant", "add", &bob, "--expires", "60s"]);
    let made = std::time::Instant::now();
    let key = format!("grant_ends/{}-{}", begins(&text(&alice.json(&["identity", "show"]), "address")), begins(&bob));
    wait_until(120, "the alert", || webhook.told("begun", &key).pop());
    assert!(made.elapsed().as_secs() >= 45, "after {:?}", made.elapsed());
    wait_until(60, "its end", || webhook.told("resolved", &key).pop());
    site.stop("INT", 20).expect_code(0);
    assert_eq!((webhook.told("begun", &key).len(), webhook.told("resolved", &key).len()), (1, 1));
}

/// As figures and alerts name an account.
fn begins(account: &str) -> String {
    account.trim_start_matches("0x").chars().take(8).collect()
}

#[test]
fn a_command_that_never_ends_holds_nothing_up_and_ends_with_its_site() {
    const SLEEP: &str = "98765.25";
    let home = Home::new();
    std::fs::create_dir(home.path()).expect("the home");
    let command = format!("[alerts]\ncommand = [\"/bin/sleep\", \"{SLEEP}\"]\nevery = 1\ndisk = \"1000000GiB\"\n");
    home.file("site/config.toml", command, 0o600);
    let authros = home.authros().with(&["--robots", "1"]);
    let site = authros.serve(&home);
    let sleeps = || {
        let lines = std::fs::read_dir("/proc").expect("Linux").flatten();
        let is_it = |path: &Path| std::fs::read(path.join("cmdline")).is_ok_and(|line| line.ends_with(b"98765.25\0"));
        lines.filter(|entry| is_it(&entry.path())).count()
    };
    wait_until(60, "the command", || (sleeps() > 0).then_some(()));
    authros.capture(&["/robot1/odom"], 5);
    let view = authros.json(&["alerts", "list"]);
    assert!(count(&view, "waiting") >= 1 && count(&view, "dropped") == 0, "{view}");
    site.stop("INT", 20).expect_code(0);
    wait_until(20, "no command outlives the site", || (sleeps() == 0).then_some(()));
}

fn openssl(folder: &Path, arguments: &str) {
    let outcome = Command::new("openssl").args(arguments.split(' ')).current_dir(folder).output().expect("openssl");
    assert!(outcome.status.success(), "{arguments}: {}", String::from_utf8_lossy(&outcome.stderr));
}

#[test]
fn a_webhook_over_tls_is_told_where_its_authority_is_known_and_nobody_else_is() {
    let Some(python) = system_program("python3") else { skipped!("no python3") };
    let home = Home::new();
    let folder = home.root();
    home.file("names", "subjectAltName=IP:127.0.0.1\nbasicConstraints=critical,CA:FALSE\n", 0o600);
    for arguments in [
        "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=yard -keyout ca.key -out ca.pem",
        "req -newkey rsa:2048 -nodes -subj /CN=hook -keyout hook.key -out hook.csr",
        "x509 -req -in hook.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 -extfile names -out hook.pem",
    ] {
        openssl(folder, arguments);
    }
    let script = "import http.server, ssl\n\
                  class Hook(http.server.BaseHTTPRequestHandler):\n\
                  \x20def do_POST(self):\n\
                  \x20 print('TOOK', self.rfile.read(int(self.headers['Content-Length'])).decode(), flush=True)\n\
                  \x20 self.send_response(204); self.end_headers()\n\
                  server = http.server.HTTPServer(('127.0.0.1', 0), Hook)\n\
                  context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)\n\
                  context.load_cert_chain('hook.pem', 'hook.key')\n\
                  server.socket = context.wrap_socket(server.socket, server_side=True)\n\
                  print('PORT %d\\n' % server.server_port, end='', flush=True)\n\
                  server.serve_forever()\n";
    let mut command = Command::new(python);
    command.args(["-c", script]).current_dir(folder);
    let mut server = Running::start(command);
    let told = server.wait_for_text("PORT", 60);
    let port = told.lines().find_map(|line| line.strip_prefix("PORT ")).expect("a port").to_owned();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.json(&["identity", "create"]);
    let named = authros.with_variable("AUTHROS_ALERTS_WEBHOOK", &format!("https://127.0.0.1:{port}/hook"));
    let message = named.fails(4, &["alerts", "test"]);
    assert!(message.contains("certificate"), "{message}");
    let roots = folder.join("ca.pem").display().to_string();
    let known = named.with_variable("AUTHROS_ALERTS_ROOTS", &roots);
    assert_eq!(text(&known.json(&["alerts", "test"]), "text"), "204");
    server.wait_for_text("\"state\":\"test\"", 30);
    let by_system = named.with_variable("SSL_CERT_FILE", &roots);
    assert_eq!(text(&by_system.json(&["alerts", "test"]), "text"), "204");
    let empty = home.file("empty.pem", "no certificate\n", 0o600);
    let message = named.with_variable("AUTHROS_ALERTS_ROOTS", &empty).fails(3, &["alerts", "test"]);
    assert!(message.contains("alerts.roots"), "{message}");
    server.stop("KILL", 10);
}

/// What an Alertmanager holds of our active alerts.
fn held(port: u16) -> Option<Vec<Value>> {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.write_all(b"GET /api/v2/alerts HTTP/1.0\r\n\r\n").ok()?;
    let mut told = String::new();
    stream.read_to_string(&mut told).ok()?;
    let (head, body) = told.split_once("\r\n\r\n")?;
    let alerts: Value = head.starts_with("HTTP/1.0 200").then(|| serde_json::from_str(body).ok())??;
    Some(alerts.as_array().expect("a list").clone())
}

#[test]
fn a_real_alertmanager_holds_an_alert_until_it_is_over() {
    let Some(program) = system_program("prometheus-alertmanager") else { skipped!("no prometheus-alertmanager") };
    let home = Home::new();
    let config = home.file("alertmanager.yml", "route: {receiver: nobody}\nreceivers: [{name: nobody}]\n", 0o600);
    let port = free_port();
    let mut command = Command::new(program);
    command.args([
        format!("--config.file={config}"),
        format!("--storage.path={}", home.root().join("alertmanager").display()),
        format!("--web.listen-address=127.0.0.1:{port}"),
        "--cluster.listen-address=".to_owned(),
    ]);
    let manager = Running::start(command);
    wait_until(60, "the Alertmanager", || held(port));
    let url = format!("http://127.0.0.1:{port}");
    let full = watched(&home, &url, "1000000GiB").with_variable("AUTHROS_ALERTS_FORM", "alertmanager");
    let site = full.serve(&home);
    let is_disk = |alert: &Value| alert["labels"]["alertname"] == "authros_disk";
    let alert = wait_until(60, "the alert", || {
        held(port)?.into_iter().find(|alert| is_disk(alert) && alert["status"]["state"] == "active")
    });
    assert_eq!((&alert["status"]["state"], &alert["labels"]["severity"]), (&"active".into(), &"critical".into()));
    assert!(text(&alert["annotations"], "summary").contains("free on the home's disk"), "{alert}");
    assert!(text(&full.json(&["alerts", "test"]), "text").starts_with("200"));
    site.stop("INT", 20).expect_code(0);
    let roomy = watched(&home, &url, "1KiB").with_variable("AUTHROS_ALERTS_FORM", "alertmanager");
    let site = roomy.serve(&home);
    wait_until(60, "no alert any more", || (!held(port)?.iter().any(is_disk)).then_some(()));
    site.stop("INT", 20).expect_code(0);
    manager.stop("TERM", 20);
}
