//! The thread that owns the screen: draws only the newest frame, only when something changed, and within its budget.

use super::encode::{Depth, FrameBackend};
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::Backend as _;
use ratatui::layout::Size;

use super::output::{THREAD_PREFIX, write};
use super::pixels::Pixels;
use crate::app::State;
use crate::config::Pictures;
use crate::ui::Theme;
use crate::ui::draw::draw;

#[derive(Debug)]
pub struct Painter {
    terminal: Terminal<FrameBackend>,
    size: (u16, u16),
    pixels: Pixels,
}

impl Painter {
    pub fn new(depth: Depth, size: (u16, u16)) -> Self {
        let backend = FrameBackend::new(depth, cells(size));
        let Ok(terminal) = Terminal::new(backend);
        Self { terminal, size, pixels: Pixels::new(Pictures::HalfBlocks, None) }
    }

    pub fn with_pixels(self, pixels: Pixels) -> Self {
        Self { pixels, ..self }
    }

    /// Empty if nothing changed.
    pub fn paint(&mut self, scene: &mut Scene) -> String {
        self.paint_at_most(scene, None)
    }

    /// Frames of at most that many bytes plus the rest of whole rows; see [`Self::is_behind`].
    pub fn paint_at_most(&mut self, scene: &mut Scene, most: Option<usize>) -> String {
        self.terminal.backend_mut().most = most;
        let mut bytes = String::new();
        let anew = std::mem::take(&mut scene.anew);
        if anew || self.size != scene.state.size {
            self.size = scene.state.size;
            bytes.push_str(self.pixels.forget());
            self.terminal.backend_mut().forget();
            self.terminal.backend_mut().resize(cells(self.size));
            let Ok(()) = self.terminal.clear();
        }
        let Self { terminal, pixels, .. } = self;
        let (mut placement, mut below) = (None, Vec::new());
        let Ok(_) = terminal.draw(|frame| {
            placement = draw(frame, &scene.state, &scene.theme);
            below = pixels.cells_below(placement.as_ref(), frame.buffer_mut());
        });
        let backend = terminal.backend_mut();
        let Ok(()) = backend.draw(below.iter().map(|(x, y, cell)| (*x, *y, cell)));
        let change = pixels.show(placement);
        change.covered.iter().for_each(|area| backend.encoder.cover(*area));
        bytes.push_str(change.away);
        bytes.push_str(&backend.take_frame());
        bytes.push_str(&change.put);
        bytes.push_str(&std::mem::take(&mut scene.extra));
        bytes
    }

    pub fn is_behind(&self) -> bool {
        !self.terminal.backend().waiting.is_empty()
    }
}

fn cells((columns, rows): (u16, u16)) -> Size {
    Size { width: columns.max(1), height: rows.max(1) }
}

/// `failed` is called when the terminal takes no more bytes.
pub fn start(
    stage: Arc<Stage>,
    mut painter: Painter,
    mut budget: Budget,
    failed: impl Fn(io::Error) + Send + 'static,
) -> io::Result<JoinHandle<()>> {
    let render = move || {
        while let Some(bytes) = next_frame(&stage, &mut painter, &budget) {
            if let Err(error) = send(&stage, &bytes) {
                return failed(error);
            }
            budget.spend(bytes.len(), Instant::now());
        }
    };
    thread::Builder::new().name(format!("{THREAD_PREFIX}renderer")).spawn(render)
}

/// `None` = the end.
fn next_frame(stage: &Stage, painter: &mut Painter, budget: &Budget) -> Option<String> {
    let mut scene = stage.scene();
    loop {
        scene = due(stage, scene, budget)?;
        let most = if scene.wish == Wish::Data { budget.most_at_once() } else { None };
        scene.wish = Wish::None;
        fail_for_the_test(&scene);
        let bytes = painter.paint_at_most(&mut scene, most);
        if painter.is_behind() {
            scene.wish = Wish::Data;
        }
        if !bytes.is_empty() {
            return Some(bytes);
        }
    }
}

/// Panics on the screen Log under AUTHROS_FAULT: proves that the terminal is restored.
fn fail_for_the_test(scene: &Scene) {
    let asked = scene.state.screen == crate::app::Screen::Log && authros_fault::is_off("renderer");
    assert!(!asked, "asked for by AUTHROS_FAULT");
}

fn due<'a>(stage: &Stage, mut scene: MutexGuard<'a, Scene>, budget: &Budget) -> Option<MutexGuard<'a, Scene>> {
    loop {
        let pause = match scene.wish {
            _ if scene.over => return None,
            _ if scene.suspended => None,
            Wish::None => None,
            Wish::Data => Some(budget.wait(Instant::now())),
            Wish::Now => Some(std::time::Duration::ZERO),
        };
        if pause.is_some_and(|pause| pause.is_zero()) {
            return Some(scene);
        }
        scene = stage.wait(scene, pause);
    }
}

/// Skips a frame if the terminal was given away while it was drawn.
fn send(stage: &Stage, bytes: &str) -> io::Result<()> {
    let _writing = stage.output.lock().unwrap_or_else(PoisonError::into_inner);
    if is_given_away(stage) { Ok(()) } else { write(bytes) }
}

/// Whether the shell has the terminal, or the renderer is to end.
fn is_given_away(stage: &Stage) -> bool {
    let mut scene = stage.scene();
    scene.anew |= scene.suspended;
    scene.suspended || scene.over
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wish {
    #[default]
    None,
    /// Within the byte budget.
    Data,
    /// Without delay.
    Now,
}

#[derive(Debug)]
pub struct Scene {
    pub state: State,
    pub theme: Theme,
    pub wish: Wish,
    pub anew: bool,
    /// Sent besides the frame.
    pub extra: String,
    /// The shell has the terminal.
    pub suspended: bool,
    /// The renderer is to end.
    pub over: bool,
}

#[derive(Debug)]
pub struct Stage {
    scene: Mutex<Scene>,
    bell: Condvar,
    /// Held while bytes are written to the terminal.
    pub output: Mutex<()>,
}

impl Stage {
    pub fn new(state: State, theme: Theme) -> Self {
        let scene =
            Scene { state, theme, wish: Wish::Now, anew: false, extra: String::new(), suspended: false, over: false };
        Self { scene: Mutex::new(scene), bell: Condvar::new(), output: Mutex::new(()) }
    }

    /// Never held while anything waits.
    pub fn scene(&self) -> MutexGuard<'_, Scene> {
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }

    #[cfg(test)]
    pub fn into_scene(self) -> Scene {
        self.scene.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn change<T>(&self, wish: Wish, change: impl FnOnce(&mut Scene) -> T) -> T {
        let mut scene = self.scene();
        let result = change(&mut scene);
        scene.wish = scene.wish.max(wish);
        drop(scene);
        self.bell.notify_all();
        result
    }

    pub fn wait<'a>(&self, scene: MutexGuard<'a, Scene>, longest: Option<Duration>) -> MutexGuard<'a, Scene> {
        match longest {
            Some(longest) => self.bell.wait_timeout(scene, longest).unwrap_or_else(PoisonError::into_inner).0,
            None => self.bell.wait(scene).unwrap_or_else(PoisonError::into_inner),
        }
    }
}

/// Default over SSH, bytes a second.
pub const OVER_SSH: u32 = 4_000;
/// Shortest time between frames for data.
const LEAST_GAP: Duration = Duration::from_millis(50);
/// A data frame occupies the line for 1/10 s.
const IN_FLIGHT: u32 = 10;

/// Bytes sent, paid for by waiting.
#[derive(Debug)]
pub struct Budget {
    bytes_per_second: Option<u32>,
    next: Instant,
}

impl Budget {
    /// `None` = only the gap counts.
    pub fn new(bytes_per_second: Option<u32>, now: Instant) -> Self {
        Self { bytes_per_second: bytes_per_second.filter(|bytes| *bytes > 0), next: now }
    }

    /// Bytes on their way when a key is pressed delay its answer; `None` = no limit.
    pub fn most_at_once(&self) -> Option<usize> {
        let rate = self.bytes_per_second?;
        usize::try_from(rate / IN_FLIGHT).ok()
    }

    pub fn wait(&self, now: Instant) -> Duration {
        self.next.saturating_duration_since(now)
    }

    pub fn spend(&mut self, bytes: usize, now: Instant) {
        let bytes = u32::try_from(bytes).unwrap_or(u32::MAX);
        let cost = self
            .bytes_per_second
            .map_or(Duration::ZERO, |rate| Duration::from_secs_f64(f64::from(bytes) / f64::from(rate)));
        // Earlier debt stays: keys draw without delay, data pays for them.
        self.next = self.next.max(now) + cost;
        self.next = self.next.max(now + LEAST_GAP);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::update::update;
    use crate::app::{Action, Key, Settings, State};
    use crate::ui::Theme;

    fn scene() -> Scene {
        let theme = Theme::named("night").expect("embedded");
        Stage::new(State::new(Settings::default()), theme).into_scene()
    }

    #[test]
    fn a_frame_that_changes_nothing_is_no_byte() {
        let mut scene = scene();
        let mut painter = Painter::new(Depth::True, (80, 24));
        let first = painter.paint(&mut scene);
        assert!(!first.is_empty() && first.len() <= 6_000, "{}", first.len());
        assert_eq!(painter.paint(&mut scene), "");
        drop(update(&mut scene.state, Action::Key(Key::Char('2'))));
        assert!(!painter.paint(&mut scene).is_empty());
        assert_eq!(painter.paint(&mut scene), "");
    }

    #[test]
    fn what_comes_in_small_frames_ends_as_the_same_screen_and_a_key_is_not_behind_it() {
        let mut scene = scene();
        let (mut painter, mut whole) = (Painter::new(Depth::True, (80, 24)), Painter::new(Depth::True, (80, 24)));
        let cells = |count| std::num::NonZeroU16::new(count).expect("not zero");
        let emulator = || vt100::Parser::new(cells(24), cells(80), 0);
        let (mut screen, mut wanted) = (emulator(), emulator());
        screen.process(painter.paint(&mut scene).as_bytes());
        drop(update(&mut scene.state, Action::Key(Key::Char('?'))));
        let first = painter.paint_at_most(&mut scene, Some(200));
        assert!(painter.is_behind() && first.len() < 500, "{}", first.len());
        screen.process(first.as_bytes());
        // A key in between that changes nothing is answered with nothing: its frame has what is new, not what waits.
        drop(update(&mut scene.state, Action::Key(Key::Up)));
        assert_eq!(painter.paint(&mut scene), "");
        assert!(painter.is_behind());
        let mut frames = 0;
        while painter.is_behind() {
            let frame = painter.paint_at_most(&mut scene, Some(200));
            assert!(!frame.is_empty() && frame.len() < 500, "{}", frame.len());
            screen.process(frame.as_bytes());
            frames += 1;
        }
        assert!(frames > 2, "{frames}");
        wanted.process(whole.paint(&mut scene).as_bytes());
        let text = |emulator: &vt100::Parser| -> Vec<String> {
            emulator.screen().contents().lines().map(|line| line.trim_end().to_owned()).collect()
        };
        assert_eq!(text(&screen), text(&wanted));
        assert_eq!(painter.paint(&mut scene), "");
    }

    #[test]
    fn a_frame_that_was_drawn_before_the_end_is_not_written_after_it() {
        let stage = Stage::new(State::new(Settings::default()), Theme::named("night").expect("embedded"));
        assert!(!is_given_away(&stage));
        stage.change(Wish::None, |scene| scene.suspended = true);
        assert!(is_given_away(&stage) && stage.scene().anew, "all is drawn anew afterwards");
        stage.change(Wish::None, |scene| (scene.suspended, scene.over) = (false, true));
        assert!(is_given_away(&stage));
    }

    #[test]
    fn a_new_size_and_a_redraw_draw_all() {
        let mut scene = scene();
        let mut painter = Painter::new(Depth::None, (80, 24));
        let first = painter.paint(&mut scene).len();
        scene.anew = true;
        let again = painter.paint(&mut scene);
        assert!(again.contains("\x1b[2J") && again.len() >= first);
        drop(update(&mut scene.state, Action::Resize { columns: 120, rows: 40 }));
        assert!(painter.paint(&mut scene).contains("\x1b[2J"));
        drop(update(&mut scene.state, Action::Resize { columns: 0, rows: 0 }));
        painter.paint(&mut scene);
    }
}

#[cfg(test)]
mod budget_tests {
    use super::*;

    #[test]
    fn data_waits_until_its_bytes_are_paid() {
        let start = Instant::now();
        let mut budget = Budget::new(Some(4_000), start);
        assert_eq!(budget.wait(start), Duration::ZERO);
        budget.spend(1_000, start);
        assert_eq!(budget.wait(start), Duration::from_millis(250));
        budget.spend(1_000, start);
        assert_eq!(budget.wait(start), Duration::from_millis(500));
        assert_eq!(budget.wait(start + Duration::from_millis(500)), Duration::ZERO);
    }

    #[test]
    fn a_second_of_frames_stays_within_the_budget() {
        let start = Instant::now();
        let mut budget = Budget::new(Some(4_000), start);
        let (mut now, mut sent) = (start, 0);
        while now < start + Duration::from_secs(10) {
            if budget.wait(now).is_zero() {
                budget.spend(700, now);
                sent += 700;
            }
            now += Duration::from_millis(1);
        }
        assert!((38_000..=40_700).contains(&sent), "{sent}");
    }

    #[test]
    fn without_a_limit_frames_keep_their_distance() {
        let start = Instant::now();
        let mut budget = Budget::new(None, start);
        budget.spend(1_000_000, start);
        assert_eq!(budget.wait(start), LEAST_GAP);
        assert_eq!(budget.wait(start + LEAST_GAP), Duration::ZERO);
    }
}
