//! The console in a pseudo-terminal, with a terminal emulator that keeps what it shows.

use std::io::{Read, Write};
use std::num::NonZeroU16;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use portable_pty::{Child, CommandBuilder, ExitStatus, MasterPty, PtyPair, PtySize, native_pty_system};
use vt100::Parser;

use super::authros::Authros;
use super::poll;
use super::process::signal;

/// A console at work; killed when dropped.
pub struct Console {
    child: Box<dyn Child + Send + Sync>,
    pair: PtyPair,
    keys: Box<dyn Write + Send>,
    screen: Arc<Mutex<Parser>>,
    modes_before: String,
}

impl Console {
    /// Opens `authros` in a terminal of 100x30.
    pub fn open(authros: &Authros) -> Self {
        Self::open_sized(authros, 30, 100)
    }

    /// Opens `authros` in a terminal of that size.
    pub fn open_sized(authros: &Authros, rows: u16, cols: u16) -> Self {
        let pair = native_pty_system()
            .openpty(PtySize { rows, cols, pixel_width: 0, pixel_height: 0 })
            .expect("a pseudo-terminal");
        let modes_before = modes(pair.master.as_ref());
        let mut command = CommandBuilder::new(env!("CARGO_BIN_EXE_authros"));
        command.args(authros.arguments(&[]));
        command.env_clear();
        for (name, value) in authros.variables() {
            command.env(name, value);
        }
        command.env("TERM", "xterm-256color");
        let child = pair.slave.spawn_command(command).expect("the console starts");
        let keys = pair.master.take_writer().expect("the keyboard");
        let size = |cells| NonZeroU16::new(cells).expect("not zero");
        let screen = Arc::new(Mutex::new(Parser::new(size(rows), size(cols), 0)));
        watch(pair.master.try_clone_reader().expect("the screen"), Arc::clone(&screen));
        Self { child, pair, keys, screen, modes_before }
    }

    /// What it shows now.
    pub fn shown(&self) -> String {
        self.emulator().screen().contents()
    }

    /// Waits until it shows `text`; gives the whole screen.
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
        poll(seconds, || self.child.try_wait().expect("its state is known"))
            .unwrap_or_else(|| panic!("not ended within {seconds} s, but shows:\n{}", self.shown()))
    }

    /// Fails the test unless the terminal is as it was before.
    pub fn expect_restored(&self) {
        // Its last bytes may still be on their way to the emulator when the process has ended.
        poll(5, || Some(()).filter(|()| !self.emulator().screen().alternate_screen()));
        let emulator = self.emulator();
        let screen = emulator.screen();
        assert!(!screen.alternate_screen(), "left in the alternate screen");
        assert!(!screen.hide_cursor(), "left without a cursor");
        assert!(!screen.bracketed_paste(), "left in bracketed paste");
        assert_eq!(screen.mouse_protocol_mode(), vt100::MouseProtocolMode::None, "left with the mouse taken");
        assert_eq!(modes(self.pair.master.as_ref()), self.modes_before, "left in raw mode");
    }

    fn emulator(&self) -> MutexGuard<'_, Parser> {
        self.screen.lock().unwrap_or_else(PoisonError::into_inner)
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

fn watch(mut source: Box<dyn Read + Send>, screen: Arc<Mutex<Parser>>) {
    std::thread::spawn(move || {
        let mut buffer = [0; 8192];
        while let Ok(length @ 1..) = source.read(&mut buffer) {
            screen.lock().unwrap_or_else(PoisonError::into_inner).process(&buffer[..length]);
        }
    });
}
