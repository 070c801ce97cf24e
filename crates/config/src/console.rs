//! The console's appearance, as far as the settings determine it.

use super::error::ConfigError;
use super::read::{Values, number, switch, value, wrong};

/// How the console shows the pictures of records.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Pictures {
    /// In cells, two pixels each.
    #[default]
    HalfBlocks,
    /// As pixels drawn by the terminal: sixel graphics.
    Sixel,
    /// As pixels drawn by the terminal: kitty's graphics protocol.
    Kitty,
}

/// What the settings say about the console.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ConsoleSettings {
    /// A theme's name; `None` = chosen to match the terminal's colours.
    pub theme: Option<String>,
    /// Only ASCII characters; `None` = decided by the locale.
    pub ascii: Option<bool>,
    /// Whether the console uses the mouse.
    pub mouse: bool,
    /// The most bytes a second drawn because data changed.
    pub bytes_per_second: Option<u32>,
    /// How pictures are shown.
    pub pictures: Pictures,
    /// Nanoseconds without a key after which the keyring locks; `None` = never.
    pub lock_after: Option<u64>,
}

impl ConsoleSettings {
    pub(super) fn read(values: &Values) -> Result<Self, ConfigError> {
        let ascii = match value(values, "console.ascii") {
            Some("yes") => Some(true),
            Some("no") => Some(false),
            Some("auto") | None => None,
            Some(_) => return Err(wrong(values, "console.ascii", "choose yes, no or auto")),
        };
        let bytes_per_second = match value(values, "console.bytes_per_second") {
            Some(_) => u32::try_from(number(values, "console.bytes_per_second", 500, 100_000_000)?).ok(),
            None => None,
        };
        let pictures = match value(values, "console.pictures") {
            Some("half-blocks") | None => Pictures::HalfBlocks,
            Some("sixel") => Pictures::Sixel,
            Some("kitty") => Pictures::Kitty,
            Some(_) => return Err(wrong(values, "console.pictures", "choose half-blocks, sixel or kitty")),
        };
        let minutes = number(values, "console.lock_after", 0, 10_080)?;
        let lock_after = (minutes > 0).then(|| minutes * 60_000_000_000);
        Ok(Self {
            lock_after,
            theme: value(values, "console.theme").map(str::to_owned),
            ascii,
            mouse: switch(values, "console.mouse", ("yes", "no"))?,
            bytes_per_second,
            pictures,
        })
    }
}
