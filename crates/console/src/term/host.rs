//! Requests to the site, its events, files, and the one channel on which everything reaches the updating thread.

use std::path::PathBuf;
use std::sync::mpsc::Sender;

use tokio::runtime::Handle;
use tokio::sync::broadcast::error::RecvError;

use super::files;
use crate::app::paths::Sought;
use crate::app::{Action, Contents, Tag};
use crate::model::ProfileName;
use crate::service::client::site_gone;
use crate::service::{Client, Command};

/// Messages to the updating thread.
pub enum Message {
    /// An action for `app::update`.
    Act(Action),
    /// A signal.
    Signal(i32),
    /// The terminal takes no more bytes.
    TerminalFailed,
    /// A thread of the console panicked.
    Broken(String),
}

/// The site and the files.
pub struct Host {
    /// Talks to the site.
    pub client: Client,
    /// Runs what waits.
    pub handle: Handle,
    /// To the updating thread.
    pub messages: Sender<Message>,
    /// Where files are written.
    pub directory: PathBuf,
}

impl Host {
    /// Forwards the site's events.
    pub fn listen(&self) {
        let mut events = self.client.events();
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn(async move {
            loop {
                match events.recv().await {
                    Ok(event) => say(Action::Told(event)),
                    Err(RecvError::Lagged(_)) => say(Action::Missed),
                    Err(RecvError::Closed) => return,
                }
            }
        });
    }

    /// Speaks for this profile from now on.
    pub fn speak_for(&mut self, profile: ProfileName) {
        self.client = self.client.for_profile(profile);
    }

    /// Sends a command; its answer comes as an action.
    pub fn ask(&self, command: Command, tag: Tag) {
        let answer = self.client.send(command);
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn(async move {
            let result = answer.await.unwrap_or_else(|_| Err(site_gone()));
            say(Action::Answered { tag, result: Box::new(result) });
        });
    }

    /// Writes files; their paths come as an action.
    pub fn write(&self, base: Option<PathBuf>, directory: Option<String>, contents: Vec<Contents>) {
        let base = base.unwrap_or_else(|| self.directory.clone());
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn_blocking(move || {
            say(Action::FilesWritten(files::write_all(&base, directory.as_deref(), &contents)));
        });
    }

    /// Reads a file as text; it comes as an action.
    pub fn read(&self, path: PathBuf) {
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn_blocking(move || {
            let read = files::read_text(&path);
            say(Action::TextRead(path, read));
        });
    }

    /// Reads which paths begin as typed; they come as an action.
    pub fn find(&self, sought: Sought) {
        let say = sender(&self.messages, Message::Act);
        self.handle.spawn_blocking(move || {
            let found = files::find(&sought);
            say(Action::PathsFound(sought, found));
        });
    }
}

/// Sends things to the updating thread, each wrapped.
pub fn sender<T, W: Fn(T) -> Message>(messages: &Sender<Message>, wrap: W) -> impl Fn(T) + use<T, W> {
    let messages = messages.clone();
    // After the end nobody listens, and nothing is lost by that.
    move |thing| drop(messages.send(wrap(thing)))
}
