//! Ratatui's backend over the encoder: frames end as bytes in memory, never on the tty.

use std::convert::Infallible;

use ratatui::backend::{Backend, ClearType, WindowSize};
use ratatui::buffer::Cell;
use ratatui::layout::{Position, Rect, Size};

use super::colour::Depth;
use super::encode::Encoder;

/// A terminal in memory that keeps only the bytes of the frame.
#[derive(Debug)]
pub struct FrameBackend {
    encoder: Encoder,
    size: Size,
    shown: bool,
    position: Position,
}

impl FrameBackend {
    /// Of that size and colour depth.
    pub fn new(depth: Depth, size: Size) -> Self {
        Self { encoder: Encoder::new(depth), size, shown: false, position: Position::ORIGIN }
    }

    /// The terminal has a new size; the next frame is drawn whole.
    pub fn resize(&mut self, size: Size) {
        self.size = size;
    }

    /// The bytes of the frame drawn last; empty where it equals the one before.
    pub fn take_frame(&mut self) -> String {
        self.encoder.cursor(self.shown.then_some(self.position));
        self.encoder.take_frame()
    }

    /// What stands in `area` was covered by a picture.
    pub fn cover(&mut self, area: Rect) {
        self.encoder.cover(area);
    }

    /// The real terminal was used by others.
    pub fn forget(&mut self) {
        self.encoder.forget();
    }
}

impl Backend for FrameBackend {
    type Error = Infallible;

    fn draw<'a, I: Iterator<Item = (u16, u16, &'a Cell)>>(&mut self, content: I) -> Result<(), Infallible> {
        for (x, y, cell) in content {
            self.encoder.cell(x, y, cell);
        }
        Ok(())
    }

    fn hide_cursor(&mut self) -> Result<(), Infallible> {
        self.shown = false;
        Ok(())
    }

    fn show_cursor(&mut self) -> Result<(), Infallible> {
        self.shown = true;
        Ok(())
    }

    fn get_cursor_position(&mut self) -> Result<Position, Infallible> {
        Ok(self.position)
    }

    fn set_cursor_position<P: Into<Position>>(&mut self, position: P) -> Result<(), Infallible> {
        self.position = position.into();
        Ok(())
    }

    fn clear(&mut self) -> Result<(), Infallible> {
        self.encoder.clear();
        Ok(())
    }

    fn clear_region(&mut self, _region: ClearType) -> Result<(), Infallible> {
        self.clear()
    }

    fn size(&self) -> Result<Size, Infallible> {
        Ok(self.size)
    }

    fn window_size(&mut self) -> Result<WindowSize, Infallible> {
        Ok(WindowSize { columns_rows: self.size, pixels: Size::ZERO })
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
