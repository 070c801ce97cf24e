//! `authros serve`: the site without a console, in the background too, and its reports to systemd.

use std::convert::Infallible;
use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Read as _};
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use authros_output::Output;
use clap::Args;
use serde_json::Value;
use tokio::signal::unix::{SignalKind, signal};
use tokio::{sync::broadcast, task::JoinHandle};

use super::connect::{Connection, Context, ProfileNeed};
use super::passphrase;
use crate::service::command::{Ask, ChainStatus, Register, SiteStatus};
use crate::service::{Client, Event, Failure, Needs, NoticeLevel, Site, is_bound, reply::internal};
use crate::{model::ErrorKind, store::files, term::signals::Handled};

/// `serve …`
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// Run in a process of its own that outlives this terminal; return when it serves
    #[arg(long)]
    pub detach: bool,
    /// Set by --detach: leave the session of the terminal
    #[arg(long, hide = true, conflicts_with = "detach")]
    pub own_session: bool,
}

/// Whether SIGHUP was ignored at the start, as nohup does.
static KEEPS_ON: OnceLock<bool> = OnceLock::new();

/// Must run before anything listens to signals.
pub fn note_hangup() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    KEEPS_ON.get_or_init(|| ignores_hangup(&status));
}

/// SIGHUP is the lowest bit of the mask.
fn ignores_hangup(status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// SIGINT: from a person, who can wait and ask again.
    Asked,
    /// SIGTERM or SIGHUP: now.
    Ordered,
}

pub async fn asked_to_end() -> Ending {
    let _handled = Handled::begin();
    let wait = |kind| async move {
        match signal(kind) {
            Ok(mut stream) => drop(stream.recv().await),
            Err(_) => std::future::pending().await,
        }
    };
    let hangup = async {
        match KEEPS_ON.get() {
            Some(true) => std::future::pending().await,
            _ => wait(SignalKind::hangup()).await,
        }
    };
    tokio::select! {
        () = wait(SignalKind::interrupt()) => Ending::Asked,
        () = wait(SignalKind::terminate()) => Ending::Ordered,
        () = hangup => Ending::Ordered,
    }
}

/// Patience with the registration at a home that worked before; it continues meanwhile.
const PATIENCE: Duration = Duration::from_secs(15);

pub async fn run(context: Context, arguments: ServeArguments, output: &Output) -> Result<u8, Failure> {
    if arguments.detach {
        return tokio::task::block_in_place(|| run_detached(&context, output));
    }
    if arguments.own_session {
        // Fails only for a group leader, which has left its terminal's session already.
        rustix::process::setsid().ok();
    }
    let connection = context.open(Needs { ros: true, chain: true }, output).await.map_err(not_started)?;
    connection.oversee();
    // A home that worked before needs no chain to start.
    let known = is_bound(&context.home, &context.config) && context.home.keyring(&context.profile).exists();
    let site = connection.site.clone();
    let begin = async |client: &Client| {
        match register(&context, client, known, output).await {
            // Capture goes on, whatever is wrong with the chain.
            Err(failure) if known && client.ask(ChainStatus).await.is_err() => {
                output.note(&format!("authros: {}; capture continues without the chain", failure.message));
            }
            registered => registered.map_err(not_started)?,
        }
        Ok(match site {
            Some(site) if context.config.ros_master.is_none() => site.ros_uri().await.ok(),
            _ => context.config.ros_master.clone(),
        })
    };
    let root = context.home.root().display().to_string();
    until_signal(connection, output, begin, |master: Option<String>, _| {
        let serving = serde_json::json!({ "serving": root, "profile": context.profile, "ros_master": master });
        output.result(&serving, || {
            let ros = master.map_or_else(String::new, |uri| format!("\nROS nodes join with ROS_MASTER_URI={uri}"));
            format!("serving {root} for profile '{}'; stop it with Ctrl-C{ros}", context.profile)
        });
    })
    .await
}

/// Opens and registers the profile; at a known home the registration continues in the background.
async fn register(context: &Context, client: &Client, known: bool, output: &Output) -> Result<(), Failure> {
    context.prepare(client, ProfileNeed::Made, output).await?;
    let client = client.clone();
    let registering = tokio::spawn(async move { client.ask(Register).await });
    let patience = if known { PATIENCE } else { Duration::MAX };
    match tokio::time::timeout(patience, registering).await {
        Ok(registered) => registered.map_err(|error| internal(error.to_string()))?.map(drop),
        Err(_) => {
            let advice = "`authros status` says what they wait for";
            output.note(&format!("authros: this profile's keys are not registered yet; {advice}"));
            Ok(())
        }
    }
}

fn not_started(failure: Failure) -> Failure {
    let message = format!("the site did not start: {}", failure.message);
    Failure::new(failure.kind, message)
}

/// Prints notices from `least` on, and lasting ones, until `end` or the site's end; starts with the subscription.
pub async fn follow(
    events: &mut broadcast::Receiver<Event>,
    least: NoticeLevel,
    output: &Output,
    end: impl Future<Output = Ending>,
) {
    tokio::pin!(end);
    loop {
        tokio::select! {
            _ = &mut end => return,
            event = events.recv() => match event {
                Ok(Event::Notice { at, level, text, about }) if level >= least || about.is_some() => {
                    output.notice(at, level, about.as_deref(), &text);
                }
                Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => {}
                Err(broadcast::error::RecvError::Closed) => return,
            },
        }
    }
}

/// Serves until a signal or the loss of the site; `tell` gets what `begin` started, and whether the site was joined.
pub async fn until_signal<T>(
    connection: Connection,
    output: &Output,
    begin: impl AsyncFnOnce(&Client) -> Result<T, Failure>,
    tell: impl FnOnce(T, bool),
) -> Result<u8, Failure> {
    // Subscribes first: startup problems are shown, and no signal is missed.
    let (joined, mut events, end) = (connection.site.is_none(), connection.client.events(), asked_to_end());
    tokio::pin!(end);
    let begun = tokio::select! {
        begun = begin(&connection.client) => begun,
        _ = &mut end => {
            connection.end().await;
            return Ok(0);
        }
    };
    match begun {
        Ok(served) => tell(served, joined),
        Err(failure) => {
            connection.end().await;
            return Err(failure);
        }
    }
    let ready = ready();
    let ended = tokio::select! {
        () = follow(&mut events, NoticeLevel::Warning, output, end) => Ok(0),
        failure = lost(&connection.client), if joined => Err(failure),
        failure = outdated(connection.site.as_deref()) => Err(failure),
    };
    drop(ready);
    connection.end().await;
    ended
}

/// The database of a site may be restored at any time.
async fn outdated(site: Option<&Site>) -> Failure {
    match site {
        Some(site) => site.outdated().await,
        None => std::future::pending().await,
    }
}

/// A joined site may end at any time.
async fn lost(client: &Client) -> Failure {
    loop {
        tokio::time::sleep(Duration::from_secs(2)).await;
        if let Err(failure) = client.ask(SiteStatus).await
            && failure.kind == ErrorKind::Unreachable
        {
            return failure;
        }
    }
}

/// The first Ctrl-C sends `stop` and continues to wait; a second one, or SIGTERM, leaves without the answer.
pub async fn until_done<A: Ask>(
    client: &Client,
    ask: A,
    stop: impl Ask,
    (stopping, left): (&str, &str),
    output: &Output,
    meanwhile: impl Future<Output = Infallible>,
) -> Result<A::Answer, Failure> {
    let (answer, mut stop) = (client.ask(ask), Some(stop));
    tokio::pin!(answer, meanwhile);
    loop {
        tokio::select! {
            answer = &mut answer => return answer,
            never = &mut meanwhile => match never {},
            ending = asked_to_end() => match stop.take().filter(|_| ending == Ending::Asked) {
                Some(stop) => {
                    output.note(&format!("{stopping} (Ctrl-C again to quit now)"));
                    client.ask(stop).await?;
                }
                None => return Err(Failure::new(ErrorKind::Incomplete, left)),
            },
        }
    }
}

/// Reports the stop to systemd when dropped.
pub struct Ready {
    beating: Option<JoinHandle<()>>,
}

/// Reports readiness, then a keep-alive twice per period of the watchdog while threads make progress: a silent peer
/// does not get it killed.
pub fn ready() -> Ready {
    say("READY=1");
    let beating = period(&variable("WATCHDOG_USEC"), &variable("WATCHDOG_PID"), std::process::id()).map(|period| {
        tokio::spawn(async move {
            loop {
                say("WATCHDOG=1");
                tokio::time::sleep(period / 2).await;
            }
        })
    });
    Ready { beating }
}

impl Drop for Ready {
    fn drop(&mut self) {
        if let Some(beating) = &self.beating {
            beating.abort();
        }
        say("STOPPING=1");
    }
}

fn variable(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

/// `None` if the watchdog watches another process.
fn period(microseconds: &str, process: &str, own: u32) -> Option<Duration> {
    let is_meant = process.is_empty() || process.parse() == Ok(own);
    let microseconds = microseconds.parse().ok().filter(|microseconds| *microseconds > 0 && is_meant)?;
    Some(Duration::from_micros(microseconds))
}

fn say(state: &str) {
    let Some(place) = std::env::var_os("NOTIFY_SOCKET").filter(|place| !place.is_empty()) else { return };
    // The program is useful without systemd.
    drop(send(&place, state));
}

fn send(place: &OsStr, state: &str) -> std::io::Result<usize> {
    let address = match place.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None => SocketAddr::from_pathname(place)?,
    };
    UnixDatagram::unbound()?.send_to_addr(state.as_bytes(), &address)
}

/// This very program, also if its file was replaced since.
pub const OWN_PROGRAM: &str = "/proc/self/exe";
/// A longer log is emptied, bytes.
const LONGEST_LOG: u64 = 1 << 20;
/// Bound on the process's first line, bytes.
const LONGEST: u64 = 64 * 1024;

/// Starts the same command without `--detach`; returns when it serves or has ended.
pub fn run_detached(context: &Context, output: &Output) -> Result<u8, Failure> {
    files::private_directory(context.home.root())?;
    let log = context.home.serve_log();
    let file = private_file(&log).map_err(|error| {
        Failure::new(ErrorKind::Home, format!("{} cannot be written: {error}; nothing was started", log.display()))
    })?;
    let mut child = start(context, file)?;
    let first = first_line(&mut child);
    match first.as_deref().and_then(|line| serde_json::from_str::<Value>(line).ok()) {
        Some(mut said) if said.get("serving").is_some() => {
            said["process"] = Value::from(child.id());
            output.result(&said, || text(&said, child.id(), &log.display().to_string()));
            Ok(0)
        }
        said => ended(child, said.as_ref(), &log.display().to_string(), output),
    }
}

fn private_file(path: &std::path::Path) -> std::io::Result<File> {
    // A running site may be writing there.
    let file = OpenOptions::new().append(true).create(true).mode(0o600).open(path)?;
    if file.metadata()?.len() > LONGEST_LOG {
        file.set_len(0)?;
    }
    Ok(file)
}

fn start(context: &Context, log: File) -> Result<Child, Failure> {
    let words = std::env::args_os().skip(1).filter(|word| word != "--detach");
    let json = (!context.global.json).then_some("--json");
    let unstarted = |error: std::io::Error| {
        Failure::new(ErrorKind::Internal, format!("the site's process cannot be started: {error}; try `authros serve`"))
    };
    let mut command = Command::new(OWN_PROGRAM);
    command.args(words).args(json).arg("--own-session").stdout(Stdio::piped()).stderr(log);
    // Only the process that needs the passphrase reads the descriptor.
    match passphrase::for_child(context)? {
        Some(secret) => {
            let input = passphrase::pipe(&secret).map_err(unstarted)?;
            command.args(["--passphrase-fd", "0"]).stdin(input);
        }
        None => {
            let inherits = context.global.passphrase_fd.is_some();
            command.stdin(if inherits { Stdio::inherit() } else { Stdio::null() });
        }
    }
    command.spawn().map_err(unstarted)
}

/// Waits for the line that it serves, or why it ended.
fn first_line(child: &mut Child) -> Option<String> {
    let mut line = String::new();
    let output = child.stdout.take()?;
    BufReader::new(output.take(LONGEST)).read_line(&mut line).ok()?;
    Some(line)
}

fn text(said: &Value, process: u32, log: &str) -> String {
    let word = |name: &str| said.get(name).and_then(Value::as_str).unwrap_or_default().to_owned();
    let master = word("ros_master");
    let ros = if master.is_empty() { String::new() } else { format!("\nROS nodes join with ROS_MASTER_URI={master}") };
    format!(
        "serving {} for profile '{}' in process {process}\nstop it with: kill -INT {process}\nwarnings go to {log}{ros}",
        word("serving"),
        word("profile"),
    )
}

fn ended(mut child: Child, said: Option<&Value>, log: &str, output: &Output) -> Result<u8, Failure> {
    let status = child.wait().map_err(|error| {
        Failure::new(ErrorKind::Internal, format!("the end of the site's process cannot be read: {error}"))
    })?;
    let message = said.and_then(|said| said.pointer("/error/message")).and_then(Value::as_str);
    let why = message.map_or_else(|| format!("its process ended ({status}); {log} has what it wrote"), str::to_owned);
    output.note(&format!("authros: nothing was left running: {why}"));
    let code = status.code().and_then(|code| u8::try_from(code).ok()).filter(|code| *code != 0);
    Ok(code.unwrap_or_else(|| ErrorKind::Internal.exit_code()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_ignored_hangup_is_one() {
        assert!(ignores_hangup("Name:\tauthros\nSigIgn:\t0000000000001001\n"));
        assert!(!ignores_hangup("Name:\tauthros\nSigIgn:\t0000000000001000\n"));
        assert!(!ignores_hangup("SigIgn:\tnonsense\n"));
        assert!(!ignores_hangup(""));
    }
}

#[cfg(test)]
mod systemd_tests {
    use super::*;

    #[test]
    fn the_watchdog_of_another_process_is_not_ours() {
        assert_eq!(period("60000000", "", 7), Some(Duration::from_secs(60)));
        assert_eq!(period("60000000", "7", 7), Some(Duration::from_secs(60)));
        assert_eq!(period("60000000", "8", 7), None);
        assert_eq!((period("", "7", 7), period("0", "", 7), period("soon", "", 7)), (None, None, None));
    }

    #[test]
    fn a_socket_is_spoken_to_by_path_and_by_abstract_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("notify");
        let listening = UnixDatagram::bind(&path).expect("bound");
        let name = format!("authros-notify-{}", std::process::id());
        let abstract_one =
            UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).expect("a name")).expect("bound");
        send(path.as_os_str(), "READY=1").expect("sent");
        send(OsStr::new(&format!("@{name}")), "STOPPING=1").expect("sent");
        let mut bytes = [0; 32];
        let count = listening.recv(&mut bytes).expect("received");
        assert_eq!(&bytes[..count], b"READY=1");
        let count = abstract_one.recv(&mut bytes).expect("received");
        assert_eq!(&bytes[..count], b"STOPPING=1");
    }
}

#[cfg(test)]
mod detach_tests {
    use super::*;

    #[test]
    fn what_serves_says_where_and_how_it_is_stopped() {
        let said = serde_json::json!({ "serving": "/h", "profile": "bob", "ros_master": null });
        let text = text(&said, 77, "/h/serve.log");
        assert!(text.contains("process 77") && text.contains("kill -INT 77") && text.contains("'bob'"), "{text}");
        assert!(!text.contains("ROS_MASTER_URI"), "{text}");
    }
}
