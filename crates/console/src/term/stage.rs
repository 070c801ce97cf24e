//! Shared by the updating thread and the renderer: the state, and what is to be drawn.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::app::State;
use crate::ui::Theme;

/// How urgently a frame is wanted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wish {
    /// Not at all.
    #[default]
    None,
    /// Data changed: within the byte budget.
    Data,
    /// A key was pressed: at once.
    Now,
}

/// The current scene.
#[derive(Debug)]
pub struct Scene {
    /// Everything the console knows.
    pub state: State,
    /// Its appearance.
    pub theme: Theme,
    /// Whether and how urgently a frame is wanted.
    pub wish: Wish,
    /// Redraw everything, not only what changed.
    pub anew: bool,
    /// Bytes to send besides the frame.
    pub extra: String,
    /// The terminal belongs to the shell for now.
    pub suspended: bool,
    /// The renderer is to end.
    pub over: bool,
}

/// A scene, and a bell that rings when it changed.
#[derive(Debug)]
pub struct Stage {
    scene: Mutex<Scene>,
    bell: Condvar,
    /// Held while bytes are written to the terminal.
    pub output: Mutex<()>,
}

impl Stage {
    /// With a first frame wanted.
    pub fn new(state: State, theme: Theme) -> Self {
        let scene =
            Scene { state, theme, wish: Wish::Now, anew: false, extra: String::new(), suspended: false, over: false };
        Self { scene: Mutex::new(scene), bell: Condvar::new(), output: Mutex::new(()) }
    }

    /// The scene, to read or to change. It is never held while anything waits.
    pub fn scene(&self) -> MutexGuard<'_, Scene> {
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The scene, once nobody shares it any more.
    #[cfg(test)]
    pub fn into_scene(self) -> Scene {
        self.scene.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the scene and wakes the renderer.
    pub fn change<T>(&self, wish: Wish, change: impl FnOnce(&mut Scene) -> T) -> T {
        let mut scene = self.scene();
        let result = change(&mut scene);
        scene.wish = scene.wish.max(wish);
        drop(scene);
        self.bell.notify_all();
        result
    }

    /// Waits for the bell, at most this long.
    pub fn wait<'a>(&self, scene: MutexGuard<'a, Scene>, longest: Option<Duration>) -> MutexGuard<'a, Scene> {
        match longest {
            Some(longest) => self.bell.wait_timeout(scene, longest).unwrap_or_else(PoisonError::into_inner).0,
            None => self.bell.wait(scene).unwrap_or_else(PoisonError::into_inner),
        }
    }
}
