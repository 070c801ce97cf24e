//! The console in a pseudo-terminal, with a terminal emulator that keeps its screen.

use std::io::{Read, Write};
use std::num::NonZeroU16;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use portable_pty::{Child, CommandBuilder, ExitStatus, MasterPty, PtyPair, PtySize, native_pty_system};
use vt100::Parser;

use super::authros::Authros;
use super::poll;
use super::process::signal;

/// A terminal to open a program in.
#[derive(Debug, Clone)]
pub struct Terminal {
    /// Rows.
    pub rows: u16,
    /// Columns.
    pub columns: u16,
    /// The value of TERM.
    pub name: &'static str,
    /// How many bytes a second it accepts; no limit if not set.
    pub bytes_per_second: Option<u32>,
    /// The time of a round trip on the line to it. The line takes in all that is sent, as a relay does, and delivers it
    /// in order, at its rate.
    pub round_trip: Option<Duration>,
}

impl Terminal {
    /// Of that size, with 256 colours.
    pub fn of(columns: u16, rows: u16) -> Self {
        Self { rows, columns, name: "xterm-256color", bytes_per_second: None, round_trip: None }
    }
}

/// What the terminal has received.
struct Received {
    emulator: Mutex<Parser>,
    bytes: AtomicU64,
    kept: Mutex<Vec<u8>>,
}

impl Received {
    fn take(&self, bytes: &[u8]) {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        self.emulator.lock().unwrap_or_else(PoisonError::into_inner).process(bytes);
        self.bytes.fetch_add(u64::try_from(bytes.len()).unwrap_or(0), Ordering::SeqCst);
    }
}

/// Keys that arrive some time after they were pressed, in order.
struct Delayed {
    sent: Sender<(Instant, Vec<u8>)>,
    delay: Duration,
}

impl Delayed {
    fn new(mut keys: Box<dyn Write + Send>, delay: Duration) -> Self {
        let (sent, pressed) = channel::<(Instant, Vec<u8>)>();
        std::thread::spawn(move || {
            for (due, bytes) in pressed {
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
                // The program may have ended meanwhile.
                drop(keys.write_all(&bytes).and_then(|()| keys.flush()));
            }
        });
        Self { sent, delay }
    }
}

impl Write for Delayed {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        drop(self.sent.send((Instant::now() + self.delay, bytes.to_vec())));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A running console; killed on drop.
pub struct Console {
    child: Box<dyn Child + Send + Sync>,
    pair: PtyPair,
    keys: Box<dyn Write + Send>,
    received: Arc<Received>,
    modes_before: String,
}

impl Console {
    /// Opens `authros` in a terminal of 100x30.
    pub fn open(authros: &Authros) -> Self {
        Self::open_in(&Terminal::of(100, 30), authros, &[])
    }

    /// Opens `authros` with further arguments in a terminal.
    pub fn open_in(terminal: &Terminal, authros: &Authros, arguments: &[&str]) -> Self {
        let program = authros.program().to_str().expect("UTF-8").to_owned();
        let words: Vec<String> = [vec![program], authros.arguments(arguments)].concat();
        Self::run(terminal, &words, &authros.variables())
    }

    /// Runs any program in a terminal, with exactly that environment.
    pub fn run(terminal: &Terminal, words: &[String], variables: &[(String, String)]) -> Self {
        let Terminal { rows, columns, .. } = *terminal;
        let pair = native_pty_system()
            .openpty(PtySize { rows, cols: columns, pixel_width: 0, pixel_height: 0 })
            .expect("a pseudo-terminal");
        let modes_before = modes(pair.master.as_ref());
        let mut command = CommandBuilder::new(&words[0]);
        command.args(&words[1..]);
        command.env_clear();
        command.env("TERM", terminal.name);
        for (name, value) in variables {
            command.env(name, value);
        }
        let child = pair.slave.spawn_command(command).expect("the program starts");
        let keys = pair.master.take_writer().expect("the keyboard");
        let keys = match terminal.round_trip {
            Some(round_trip) => Box::new(Delayed::new(keys, round_trip / 2)),
            None => keys,
        };
        let size = |cells| NonZeroU16::new(cells).expect("not zero");
        let received = Arc::new(Received {
            emulator: Mutex::new(Parser::new(size(rows), size(columns), 0)),
            bytes: AtomicU64::new(0),
            kept: Mutex::default(),
        });
        let source = pair.master.try_clone_reader().expect("the screen");
        match (terminal.round_trip, terminal.bytes_per_second) {
            (Some(round_trip), Some(rate)) => relay(source, Arc::clone(&received), rate, round_trip / 2),
            (_, rate) => watch(source, Arc::clone(&received), rate),
        }
        Self { child, pair, keys, received, modes_before }
    }

    /// How many bytes it has sent to the terminal so far.
    pub fn bytes(&self) -> u64 {
        self.received.bytes.load(Ordering::SeqCst)
    }

    /// Everything it has sent so far, unchanged.
    pub fn raw(&self) -> Vec<u8> {
        self.received.kept.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.process_id().expect("a process")
    }

    /// Whether it still runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Its current screen.
    pub fn shown(&self) -> String {
        self.emulator().screen().contents()
    }

    /// Waits until it shows `text`; returns the whole screen.
    pub fn wait_for(&mut self, text: &str, seconds: u64) -> String {
        poll(seconds, || Some(self.shown()).filter(|shown| shown.contains(text))).unwrap_or_else(|| {
            let ended = self.child.try_wait();
            panic!("'{text}' not shown within {seconds} s (ended: {ended:?}), but:\n{}", self.shown())
        })
    }

    /// Types.
    pub fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).expect("the keys are taken");
        self.keys.flush().expect("the keys are taken");
    }

    /// Changes the terminal's size.
    pub fn resize(&mut self, rows: u16, cols: u16) {
        let size = |cells| NonZeroU16::new(cells).expect("not zero");
        self.emulator().screen_mut().set_size(size(rows), size(cols));
        self.pair.master.resize(PtySize { rows, cols, pixel_width: 0, pixel_height: 0 }).expect("the size is set");
    }

    /// Sends a signal by name.
    pub fn signal(&self, name: &str) {
        signal(name, &self.child.process_id().expect("a process").to_string());
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|ended| ended.is_some())
    }

    /// Waits for its end.
    pub fn wait(&mut self, seconds: u64) -> ExitStatus {
        let status = poll(seconds, || self.child.try_wait().expect("its state is known"))
            .unwrap_or_else(|| panic!("not ended within {seconds} s, but shows:\n{}", self.shown()));
        // Its last bytes may still be on their way.
        let mut before = usize::MAX;
        poll(5, || Some(()).filter(|()| std::mem::replace(&mut before, self.raw().len()) == self.raw().len()));
        status
    }

    /// Fails the test unless the terminal is as it was before.
    pub fn expect_restored(&self) {
        // When the process has ended, its last bytes may still be on their way to the emulator.
        poll(5, || Some(()).filter(|()| !self.emulator().screen().alternate_screen()));
        let emulator = self.emulator();
        let screen = emulator.screen();
        assert!(!screen.alternate_screen(), "left in the alternate screen");
        assert!(!screen.hide_cursor(), "left without a cursor");
        assert!(!screen.bracketed_paste(), "left in bracketed paste");
        assert_eq!(screen.mouse_protocol_mode(), vt100::MouseProtocolMode::None, "left with the mouse taken");
        assert_eq!(modes(self.pair.master.as_ref()), self.modes_before, "left in raw mode");
    }

    /// Whether the terminal is as it was before.
    pub fn is_restored(&self) -> bool {
        // The last bytes may still be on their way.
        let is_free = || {
            let emulator = self.emulator();
            let screen = emulator.screen();
            let mouse = screen.mouse_protocol_mode() != vt100::MouseProtocolMode::None;
            let held = screen.alternate_screen() || screen.hide_cursor() || screen.bracketed_paste() || mouse;
            (!held && modes(self.pair.master.as_ref()) == self.modes_before).then_some(())
        };
        poll(3, is_free).is_some()
    }

    fn emulator(&self) -> MutexGuard<'_, Parser> {
        self.received.emulator.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        if let (Ok(None), Some(id)) = (self.child.try_wait(), self.child.process_id()) {
            signal("KILL", &id.to_string());
            drop(self.child.wait());
        }
    }
}

fn modes(master: &dyn MasterPty) -> String {
    format!("{:?}", master.get_termios().expect("the terminal's modes"))
}

/// Reads its output, no faster than the terminal accepts it, and keeps it.
fn watch(mut source: Box<dyn Read + Send>, received: Arc<Received>, bytes_per_second: Option<u32>) {
    std::thread::spawn(move || {
        let mut buffer = [0; 8192];
        // Fifty pieces a second, as over a slow link.
        let most = bytes_per_second.map_or(buffer.len(), |rate| usize::try_from(rate / 50).unwrap_or(1).max(1));
        while let Ok(length @ 1..) = source.read(&mut buffer[..most]) {
            if let Some(rate) = bytes_per_second {
                let bytes = u32::try_from(length).unwrap_or(u32::MAX);
                std::thread::sleep(Duration::from_secs_f64(f64::from(bytes) / f64::from(rate)));
            }
            received.take(&buffer[..length]);
        }
    });
}

/// Takes its output in at once, and delivers it at `rate` bytes a second, each byte `delay` after it left.
fn relay(mut source: Box<dyn Read + Send>, received: Arc<Received>, rate: u32, delay: Duration) {
    let (sent, line) = channel::<(Instant, Vec<u8>)>();
    std::thread::spawn(move || {
        let mut buffer = [0; 8192];
        while let Ok(length @ 1..) = source.read(&mut buffer) {
            drop(sent.send((Instant::now(), buffer[..length].to_vec())));
        }
    });
    std::thread::spawn(move || {
        // When the line is free again.
        let mut free = Instant::now();
        for (came, bytes) in line {
            free = free.max(came);
            // In pieces of a fiftieth of a second.
            for piece in bytes.chunks(usize::try_from(rate / 50).unwrap_or(1).max(1)) {
                let length = u32::try_from(piece.len()).unwrap_or(u32::MAX);
                free += Duration::from_secs_f64(f64::from(length) / f64::from(rate));
                std::thread::sleep((free + delay).saturating_duration_since(Instant::now()));
                received.take(piece);
            }
        }
    });
}
