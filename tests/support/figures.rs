//! How the console behaves in a terminal, measured from outside: bytes, times, CPU, what it leaves behind.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::console::{Console, Terminal};
use super::process::{Running, signal};
use super::{Authros, Home, poll};

/// The end of a frame that is shown all at once.
const END_FRAME: &[u8] = b"\x1b[?2026l";

/// A console in a terminal, started the same way each time.
pub struct Subject {
    words: Vec<String>,
    variables: Vec<(String, String)>,
    _home: Home,
}

impl Subject {
    /// The console, with this many simulated robots.
    pub fn authros(robots: u32) -> Self {
        let home = Home::new();
        let robots = robots.to_string();
        let authros = home.authros().with(&["--robots", &robots]);
        Self::of(home, &authros)
    }

    /// The given console.
    pub fn of(home: Home, authros: &Authros) -> Self {
        let program = authros.program().to_str().expect("UTF-8").to_owned();
        let words = [vec![program], authros.arguments(&[])].concat();
        Self { words, variables: authros.variables(), _home: home }
    }

    /// Starts it in a terminal.
    pub fn start(&self, terminal: &Terminal) -> Console {
        Console::run(terminal, &self.words, &self.variables)
    }
}

/// The first frame.
#[derive(Debug, Clone, Copy)]
pub struct FirstFrame {
    /// From the start of the process, milliseconds.
    pub milliseconds: f64,
    /// Bytes until then.
    pub bytes: u64,
}

/// Starts it and waits for its first frame: a screen with text on more than five lines.
pub fn first_frame(subject: &Subject) -> FirstFrame {
    let begin = Instant::now();
    let console = subject.start(&Terminal::of(80, 24));
    let lines = |console: &Console| console.shown().lines().filter(|line| !line.trim().is_empty()).count();
    let bytes = tight(30, || (lines(&console) > 5).then(|| console.bytes())).expect("a first frame");
    let milliseconds = begin.elapsed().as_secs_f64() * 1000.0;
    let raw = console.raw();
    let end = raw.windows(END_FRAME.len()).position(|window| window == END_FRAME);
    let whole = end.map_or(bytes, |end| u64::try_from(end + END_FRAME.len()).expect("few bytes"));
    FirstFrame { milliseconds, bytes: whole }
}

/// What it costs while idle.
#[derive(Debug, Clone, Copy)]
pub struct Idle {
    /// Bytes a second.
    pub bytes: f64,
    /// CPU of the whole process, percent of one core.
    pub cpu: f64,
}

/// Waits until the console's site is there and its lists have come; it draws before.
fn up(console: &Console) {
    let waits =
        |shown: &str| shown.trim().is_empty() || ["starting…", "Asking"].iter().any(|word| shown.contains(word));
    poll(30, || (!waits(&console.shown())).then_some(()));
}

/// Waits until it is up, then observes it for this long.
pub fn idle(subject: &Subject, terminal: &Terminal, settle: Duration, watch: Duration) -> Idle {
    let console = subject.start(terminal);
    up(&console);
    std::thread::sleep(settle);
    let (bytes, cpu, begin) = (console.bytes(), cpu_seconds(console.id()), Instant::now());
    std::thread::sleep(watch);
    let seconds = begin.elapsed().as_secs_f64();
    let bytes = console.bytes() - bytes;
    Idle {
        bytes: f64::from(u32::try_from(bytes).unwrap_or(u32::MAX)) / seconds,
        cpu: (cpu_seconds(console.id()) - cpu) / seconds * 100.0,
    }
}

/// Bytes for one press of a cursor key, the mean of `presses`; `before` are pressed first, and one more round is made
/// before counting begins.
pub fn bytes_per_key(subject: &Subject, before: &[&str], keys: &[&str], presses: u32) -> f64 {
    let mut console = subject.start(&Terminal::of(80, 24));
    up(&console);
    std::thread::sleep(Duration::from_secs(2));
    for key in before {
        console.press(key);
        quiet(&console);
        up(&console);
    }
    let press = |console: &mut Console, count: u32| {
        for key in keys.iter().cycle().take(count as usize) {
            console.press(key);
            quiet(console);
        }
    };
    press(&mut console, 2);
    let begin = console.bytes();
    press(&mut console, presses);
    f64::from(u32::try_from(console.bytes() - begin).unwrap_or(u32::MAX)) / f64::from(presses)
}

/// How it reacts to losing its terminal.
#[derive(Debug, Clone)]
pub struct Lost {
    /// Seconds until its end; nothing if it stays.
    pub ended_after: Option<f64>,
    /// CPU while it was still there, percent.
    pub cpu: f64,
    /// Its exit code, if it ended.
    pub code: Option<i32>,
}

/// Takes the terminal away, with the accompanying signal (`hung_up`) or without it.
pub fn lost(subject: &Subject, directory: &Path, hung_up: bool) -> Lost {
    let (running, process) = in_script(subject, directory, hung_up);
    // `script` shows what it draws; before that it may not have taken the terminal.
    poll(60, || (running.stdout().len() > 500).then_some(()));
    std::thread::sleep(Duration::from_secs(2));
    let (before, begin) = (cpu_seconds(process), Instant::now());
    signal("KILL", &running.id().to_string());
    let alive = || is_alive(process);
    let mut last = before;
    let ended_after = tight(30, || {
        last = last.max(cpu_seconds(process));
        (!alive()).then(|| begin.elapsed().as_secs_f64())
    });
    let seconds = begin.elapsed().as_secs_f64();
    if ended_after.is_none() {
        signal("KILL", &process.to_string());
    }
    let code = poll(5, || fs::read_to_string(directory.join("code")).ok()?.trim().parse().ok());
    Lost { ended_after, cpu: (last - before) / seconds * 100.0, code: code.filter(|_| ended_after.is_some()) }
}

/// Runs it in the terminal of `script`, whose end takes the terminal away; returns `script` and the program's id.
fn in_script(subject: &Subject, directory: &Path, hung_up: bool) -> (Running, u32) {
    let quoted: Vec<String> = subject.words.iter().map(|word| format!("'{word}'")).collect();
    let (id, code) = (directory.join("id"), directory.join("code"));
    for file in [&id, &code] {
        drop(fs::remove_file(file));
    }
    let path = |path: &PathBuf| path.to_str().expect("UTF-8").to_owned();
    // The shell outlives the terminal to record the exit code. Without a controlling terminal no SIGHUP is sent.
    let own_session = if hung_up { "" } else { "setsid -w " };
    let inner = format!(
        "trap : HUP; stty rows 24 cols 80; {own_session}sh -c 'echo $$ > \"$0\"; exec \"$@\"' '{}' {}; echo $? > '{}'",
        path(&id),
        quoted.join(" "),
        path(&code)
    );
    let mut command = std::process::Command::new("script");
    command.args(["-qfc", &inner, "/dev/null"]).env_clear().envs(subject.variables.iter().cloned());
    command.env("TERM", "xterm-256color").current_dir(directory);
    let running = Running::start(command);
    let process = poll(20, || fs::read_to_string(&id).ok()?.trim().parse().ok()).expect("the program starts");
    (running, process)
}

/// CPU used by all threads of a process, seconds; 0 if it is gone.
pub fn cpu_seconds(process: u32) -> f64 {
    let threads = fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten();
    let nanoseconds = |thread: fs::DirEntry| -> Option<f64> {
        fs::read_to_string(thread.path().join("schedstat")).ok()?.split(' ').next()?.parse().ok()
    };
    threads.filter_map(nanoseconds).sum::<f64>() / 1e9
}

fn is_alive(process: u32) -> bool {
    let state = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let state = state.rsplit(')').next().unwrap_or_default().trim_start().chars().next();
    state.is_some_and(|state| state != 'Z')
}

/// Waits until nothing has come for a while.
fn quiet(console: &Console) {
    let mut last = (console.bytes(), Instant::now());
    poll(3, || {
        let bytes = console.bytes();
        if bytes != last.0 {
            last = (bytes, Instant::now());
        }
        Some(()).filter(|()| last.1.elapsed() > Duration::from_millis(150))
    });
}

/// [`poll`] with a finer interval, for measuring.
fn tight<T>(seconds: u64, mut probe: impl FnMut() -> Option<T>) -> Option<T> {
    let end = Instant::now() + Duration::from_secs(seconds);
    loop {
        if let Some(found) = probe() {
            return Some(found);
        }
        if Instant::now() > end {
            return None;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}
