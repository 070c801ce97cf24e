//! The one place that maps colours to the terminal's abilities: truecolor, 256, 16, none.

use ratatui::style::Color;

use crate::ui::palette::{Rgb, SIXTEEN as BASIC, distance};
use crate::ui::theme::Shades;

/// How many colours the terminal has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// 24 bit.
    True,
    /// The xterm palette.
    Indexed,
    /// The sixteen ANSI colours.
    Sixteen,
    /// None; bold, underline and reverse only.
    None,
}

impl Depth {
    /// From the environment: `NO_COLOR`, `COLORTERM`, `TERM`.
    pub fn from_environment(variable: impl Fn(&str) -> Option<String>) -> Self {
        let is = |name: &str| variable(name).filter(|value| !value.is_empty());
        let term = is("TERM").unwrap_or_default();
        if is("NO_COLOR").is_some() || term.is_empty() || term == "dumb" || term.starts_with("vt") {
            return Self::None;
        }
        let colour = is("COLORTERM").unwrap_or_default();
        if colour == "truecolor" || colour == "24bit" || term.ends_with("-direct") {
            return Self::True;
        }
        if term.contains("256color") { Self::Indexed } else { Self::Sixteen }
    }

    /// How many colours pictures may have.
    pub fn shades(self) -> Shades {
        match self {
            Self::True | Self::Indexed => Shades::All,
            Self::Sixteen => Shades::Sixteen,
            Self::None => Shades::None,
        }
    }

    /// The colour sent for a colour of the theme; `None` = the terminal's own.
    pub fn map(self, colour: Color) -> Option<Sent> {
        let Color::Rgb(red, green, blue) = colour else { return None };
        match self {
            Self::True => Some(Sent::Rgb(red, green, blue)),
            Self::Indexed => Some(Sent::Indexed(indexed((red, green, blue)))),
            Self::Sixteen => Some(Sent::Basic(basic((red, green, blue)))),
            Self::None => None,
        }
    }
}

/// A colour as it is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sent {
    /// `38;2;r;g;b`.
    Rgb(u8, u8, u8),
    /// `38;5;n`.
    Indexed(u8),
    /// `30` to `37`, `90` to `97`.
    Basic(u8),
}

const CUBE: [u8; 6] = [0, 95, 135, 175, 215, 255];

fn basic(colour: Rgb) -> u8 {
    let nearest = (0u8..16).min_by_key(|index| distance(colour, BASIC[usize::from(*index)]));
    nearest.unwrap_or(7)
}

/// The nearest colour of the 6x6x6 cube and the 24 greys.
fn indexed(colour: Rgb) -> u8 {
    let cube = (0u8..216).map(|place| {
        let part = |step: u8| CUBE[usize::from(place / step % 6)];
        (16 + place, (part(36), part(6), part(1)))
    });
    let greys = (0u8..24).map(|step| (232 + step, (8 + step * 10, 8 + step * 10, 8 + step * 10)));
    cube.chain(greys).min_by_key(|(_, other)| distance(colour, *other)).map_or(7, |(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn depth(pairs: &[(&str, &str)]) -> Depth {
        Depth::from_environment(|name| {
            pairs.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn the_environment_says_how_many_colours() {
        assert_eq!(depth(&[("TERM", "xterm-256color"), ("COLORTERM", "truecolor")]), Depth::True);
        assert_eq!(depth(&[("TERM", "screen-256color")]), Depth::Indexed);
        assert_eq!(depth(&[("TERM", "linux")]), Depth::Sixteen);
        assert_eq!(depth(&[("TERM", "dumb")]), Depth::None);
        assert_eq!(depth(&[]), Depth::None);
        assert_eq!(depth(&[("TERM", "xterm-256color"), ("NO_COLOR", "1")]), Depth::None);
        assert_eq!(depth(&[("TERM", "xterm-256color"), ("NO_COLOR", "")]), Depth::Indexed);
    }

    #[test]
    fn a_colour_is_the_nearest_the_terminal_has() {
        let orange = Color::Rgb(255, 135, 0);
        assert_eq!(Depth::True.map(orange), Some(Sent::Rgb(255, 135, 0)));
        assert_eq!(Depth::Indexed.map(orange), Some(Sent::Indexed(208)));
        assert_eq!(Depth::Indexed.map(Color::Rgb(8, 8, 8)), Some(Sent::Indexed(232)));
        assert_eq!(Depth::Sixteen.map(Color::Rgb(255, 255, 255)), Some(Sent::Basic(15)));
        assert_eq!(Depth::Sixteen.map(Color::Rgb(20, 20, 10)), Some(Sent::Basic(0)));
        assert_eq!(Depth::None.map(orange), None);
        assert_eq!(Depth::True.map(Color::Reset), None);
    }
}
