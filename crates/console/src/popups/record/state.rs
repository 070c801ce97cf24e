//! An opened record and its faces.

use strum::IntoStaticStr;
use zeroize::Zeroizing;

use crate::app::{event::Contents, verb::Errand, verb::Tag};
use crate::popups::lookup::Lookup;
use crate::service::{command::ViewPath, reply::OpenedView, reply::PathView};

/// Records of a requested path.
const PATH: usize = 200;

pub const BYTES_A_LINE: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq, IntoStaticStr)]
pub enum Face {
    #[strum(serialize = "Values")]
    Readable,
    /// Points of a plane, or the path over the topic's records.
    Plot,
    Picture,
    Fields,
    Bytes,
}

impl Face {
    pub fn title(self) -> &'static str {
        self.into()
    }

    /// The first is shown first.
    pub fn of(view: &OpenedView) -> Vec<Self> {
        let readable = view.readable.as_ref();
        let has = |found: bool, face| found.then_some(face);
        let faces = [
            has(readable.is_some_and(|readable| readable.picture.is_some()), Self::Picture),
            has(readable.is_some(), Self::Readable),
            has(readable.is_some_and(|readable| readable.plot.is_some()), Self::Plot),
            has(true, Self::Fields),
            has(!view.beginning.is_empty(), Self::Bytes),
        ];
        faces.into_iter().flatten().collect()
    }
}

#[derive(Debug)]
pub struct Opening {
    pub lookup: Lookup<OpenedView>,
    pub face: usize,
    /// Whether a picture or plot fills the window.
    pub alone: bool,
    pub path: Option<Lookup<PathView>>,
}

impl Opening {
    pub fn new(id: &str) -> Self {
        Self { lookup: Lookup::new(id), face: 0, alone: false, path: None }
    }

    pub fn shown(&self) -> Face {
        let faces = self.lookup.found().map(Face::of).unwrap_or_default();
        faces.get(self.face).copied().unwrap_or(Face::Fields)
    }

    pub fn hints(&self) -> Vec<(&'static str, &'static str)> {
        let Some(view) = self.lookup.found() else { return vec![("q", "close")] };
        let mut hints = vec![("tab", "next view"), ("n p", "next/prev")];
        hints.push(if self.is_drawn() { ("enter", "larger") } else { ("up down", "scroll") });
        if writable(view).is_some() {
            hints.extend([("W", "save"), ("y", "copy digest")]);
        }
        hints.push(("q", "close"));
        hints
    }

    pub fn is_drawn(&self) -> bool {
        matches!(self.shown(), Face::Picture | Face::Plot)
    }

    pub fn turn(&mut self, back: bool) {
        let count = self.lookup.found().map_or(1, |view| Face::of(view).len());
        self.face = (self.face + if back { count - 1 } else { 1 }) % count;
        self.lookup.scroll = 0;
    }

    /// Requests the path once, when it is to be shown.
    pub fn wants_path(&mut self) -> Option<Errand> {
        let plot = self.lookup.found()?.readable.as_ref()?.plot.as_ref()?;
        if self.shown() != Face::Plot || !plot.path || plot.points.len() > 1 || self.path.is_some() {
            return None;
        }
        let id = self.lookup.id.clone();
        self.path = Some(Lookup::new(&id));
        let command = ViewPath { id: id.clone(), records: PATH }.into();
        Some(Errand { command, tag: Tag::Path(id) })
    }

    pub fn lines(&self) -> usize {
        let Some(view) = self.lookup.found() else { return 0 };
        match self.shown() {
            Face::Readable => view.readable.as_ref().map_or(0, |readable| {
                readable.lines.len() + readable.tables.iter().map(|table| table.rows.len() + 3).sum::<usize>()
            }),
            Face::Fields => view.fields.len() + 8,
            Face::Bytes => view.beginning.len().div_ceil(BYTES_A_LINE),
            Face::Plot | Face::Picture => 0,
        }
    }
}

/// The picture, or else the bytes, or else the fields; `None` if too long.
pub fn writable(view: &OpenedView) -> Option<Contents> {
    let plain = |character: char| if character.is_ascii_alphanumeric() { character } else { '_' };
    let stem: String = view.record.topic.trim_matches('/').chars().map(plain).collect();
    let named = |extension: &str, bytes: &[u8]| Contents {
        name: format!("{stem}-{}.{extension}", view.record.seq),
        bytes: Zeroizing::new(bytes.to_vec()),
    };
    if let Some(picture) = &view.picture {
        let extension = if picture.starts_with(b"\x89PNG") { "png" } else { "jpg" };
        return Some(named(extension, picture));
    }
    match &view.body {
        Some(body) => Some(named("bin", body)),
        None if view.message.is_null() || view.record.bytes > 4 << 20 => None,
        None => Some(named("json", view.message.to_string().as_bytes())),
    }
}
