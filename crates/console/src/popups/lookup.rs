//! Something asked for by its id; scrolling and choosing in a list.

use crate::app::key::Key;
use crate::service::Failure;

#[derive(Debug)]
pub struct Lookup<T> {
    pub id: String,
    /// `None` until it arrives.
    pub answer: Option<Result<Box<T>, Failure>>,
    pub scroll: usize,
}

impl<T> Lookup<T> {
    pub fn new(id: &str) -> Self {
        Self { id: id.to_owned(), answer: None, scroll: 0 }
    }

    pub fn found(&self) -> Option<&T> {
        self.answer.as_ref()?.as_ref().ok().map(Box::as_ref)
    }

    /// Scrolls an answer of about that many lines; false = the key closes it.
    pub fn scrolls(&mut self, key: Key, page: usize, lines: impl FnOnce(&T) -> usize) -> bool {
        let Some(scroll) = scrolled(self.scroll, key, page) else { return false };
        self.scroll = scroll.min(self.found().map_or(0, lines));
        true
    }
}

/// `None` = the key closes it.
pub fn scrolled(scroll: usize, key: Key, page: usize) -> Option<usize> {
    Some(match key {
        Key::Escape | Key::Char('q') => return None,
        Key::Up | Key::Char('k') => scroll.saturating_sub(1),
        Key::Down | Key::Char('j') => scroll + 1,
        Key::PageUp => scroll.saturating_sub(page),
        Key::PageDown | Key::Char(' ') => scroll + page,
        Key::Home => 0,
        _ => scroll,
    })
}

pub fn moved(selected: usize, count: usize, key: Key) -> usize {
    let last = count.saturating_sub(1);
    let selected = selected.min(last);
    match key {
        Key::Up | Key::BackTab | Key::Char('k') => selected.saturating_sub(1),
        Key::Down | Key::Tab | Key::Char('j') => (selected + 1).min(last),
        Key::Home => 0,
        Key::End | Key::Char('G') => last,
        _ => selected,
    }
}
