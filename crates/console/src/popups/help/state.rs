//! Help.

use crate::app::form::Field;

#[derive(Debug, Default)]
pub struct Help {
    pub scroll: usize,
    /// Typed after `/`.
    pub filter: Field,
    pub filtering: bool,
    /// Keys of the window below; `None` = those of the screen.
    pub window: Option<Vec<(&'static str, &'static str)>>,
}
