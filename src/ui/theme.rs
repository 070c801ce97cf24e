//! Roles to colours. Code speaks of roles only; the colours are in `themes/*.toml`.

use std::collections::BTreeMap;

use ratatui::style::{Color, Modifier, Style};
use serde::Deserialize;

use crate::model::clean;

/// What a piece of text is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Ordinary text, the terminal's own colour.
    #[default]
    Body,
    /// Titles and column heads.
    Title,
    /// Less important text.
    Dim,
    /// What stands out: names, numbers looked for.
    Accent,
    /// Well.
    Good,
    /// Waits or was counted.
    Warning,
    /// Wrong.
    Bad,
    /// Under the cursor.
    Selection,
    /// Lines around popups.
    Border,
    /// PAUSED, SIMULATED, the screen in view.
    Badge,
    /// A key to press.
    Key,
}

impl Role {
    /// All roles; a theme names each exactly once.
    pub const ALL: [Self; 11] = [
        Self::Body,
        Self::Title,
        Self::Dim,
        Self::Accent,
        Self::Good,
        Self::Warning,
        Self::Bad,
        Self::Selection,
        Self::Border,
        Self::Badge,
        Self::Key,
    ];
}

/// The look of one role, as written in a theme file.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools, reason = "each is a key of the theme file")]
struct Paint {
    fg: Option<String>,
    bg: Option<String>,
    bold: bool,
    dim: bool,
    underline: bool,
    reversed: bool,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ThemeFile {
    name: String,
    assumed: Option<String>,
    roles: BTreeMap<Role, Paint>,
}

/// Why a theme cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ThemeError {
    /// There is no theme of that name.
    #[error("there is no theme '{0}'; choose night, day, contrast or mono")]
    Unknown(String),
    /// The file is not a theme.
    #[error("the theme file is wrong: {0}")]
    Syntax(String),
    /// A role is missing.
    #[error("the theme names no look for the role {0:?}; add it under [roles]")]
    Missing(Role),
    /// A colour is not `#rrggbb`.
    #[error("'{0}' is not a colour; write #rrggbb")]
    Colour(String),
}

/// The embedded themes, in the order in which they are switched.
const EMBEDDED: [(&str, &str); 4] = [
    ("night", include_str!("../../themes/night.toml")),
    ("day", include_str!("../../themes/day.toml")),
    ("contrast", include_str!("../../themes/contrast.toml")),
    ("mono", include_str!("../../themes/mono.toml")),
];

/// How each role looks.
#[derive(Debug, Clone)]
pub struct Theme {
    /// Its name.
    pub name: String,
    /// Draw with ASCII characters only.
    pub ascii: bool,
    /// The background the colours are made for.
    pub assumed: Option<(u8, u8, u8)>,
    styles: [Style; Role::ALL.len()],
}

impl Theme {
    /// The embedded theme of that name.
    ///
    /// # Errors
    /// [`ThemeError::Unknown`] where there is none.
    pub fn named(name: &str) -> Result<Self, ThemeError> {
        let found = EMBEDDED.iter().find(|(known, _)| *known == name);
        let (_, text) = found.ok_or_else(|| ThemeError::Unknown(clean(name, 40)))?;
        Self::parse(text)
    }

    /// The embedded theme behind the one of that name.
    pub fn name_after(name: &str) -> &'static str {
        let place = EMBEDDED.iter().position(|(known, _)| *known == name).map_or(0, |place| place + 1);
        EMBEDDED[place % EMBEDDED.len()].0
    }

    /// A theme from the text of its file.
    ///
    /// # Errors
    /// [`ThemeError`] naming what is wrong.
    pub fn parse(text: &str) -> Result<Self, ThemeError> {
        let file: ThemeFile =
            toml::from_str(text).map_err(|error| ThemeError::Syntax(clean(&error.to_string(), 200)))?;
        let mut styles = [Style::default(); Role::ALL.len()];
        for (style, role) in styles.iter_mut().zip(Role::ALL) {
            *style = file.roles.get(&role).ok_or(ThemeError::Missing(role))?.style()?;
        }
        let assumed = file.assumed.as_deref().map(rgb).transpose()?;
        Ok(Self { name: clean(&file.name, 30), ascii: false, assumed, styles })
    }

    /// The same theme, drawn with ASCII characters only or not.
    pub fn with_ascii(self, ascii: bool) -> Self {
        Self { ascii, ..self }
    }

    /// How a role looks.
    pub fn style(&self, role: Role) -> Style {
        self.styles[role as usize]
    }
}

impl Paint {
    fn style(&self) -> Result<Style, ThemeError> {
        let fg = self.fg.as_deref().map(colour).transpose()?;
        let bg = self.bg.as_deref().map(colour).transpose()?;
        let mut style = Style { fg, bg, ..Style::default() };
        let wanted = [
            (self.bold, Modifier::BOLD),
            (self.dim, Modifier::DIM),
            (self.underline, Modifier::UNDERLINED),
            (self.reversed, Modifier::REVERSED),
        ];
        for (_, modifier) in wanted.into_iter().filter(|(on, _)| *on) {
            style = style.add_modifier(modifier);
        }
        Ok(style)
    }
}

fn colour(text: &str) -> Result<Color, ThemeError> {
    rgb(text).map(|(red, green, blue)| Color::Rgb(red, green, blue))
}

fn rgb(text: &str) -> Result<(u8, u8, u8), ThemeError> {
    let wrong = || ThemeError::Colour(clean(text, 20));
    let number = text.strip_prefix('#').filter(|digits| digits.len() == 6).ok_or_else(wrong)?;
    let [_, red, green, blue] = u32::from_str_radix(number, 16).map_err(|_| wrong())?.to_be_bytes();
    Ok((red, green, blue))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance of WCAG 2.
    fn luminance((red, green, blue): (u8, u8, u8)) -> f64 {
        let linear = |part: u8| {
            let part = f64::from(part) / 255.0;
            if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * linear(red) + 0.7152 * linear(green) + 0.0722 * linear(blue)
    }

    fn contrast(one: (u8, u8, u8), other: (u8, u8, u8)) -> f64 {
        let (one, other) = (luminance(one), luminance(other));
        (one.max(other) + 0.05) / (one.min(other) + 0.05)
    }

    fn parts(colour: Option<Color>) -> Option<(u8, u8, u8)> {
        match colour {
            Some(Color::Rgb(red, green, blue)) => Some((red, green, blue)),
            _ => None,
        }
    }

    #[test]
    fn every_colour_is_readable_on_its_background() {
        for (name, _) in EMBEDDED {
            let theme = Theme::named(name).expect("embedded");
            assert_eq!(theme.name, name);
            for role in Role::ALL {
                let style = theme.style(role);
                let Some(text) = parts(style.fg) else { continue };
                let ground = parts(style.bg).or(theme.assumed).expect("a background");
                assert!(contrast(text, ground) >= 4.5, "{name} {role:?}: {:.2}", contrast(text, ground));
            }
        }
    }

    #[test]
    fn body_text_is_the_terminals_own_and_mono_has_no_colour() {
        for (name, _) in EMBEDDED {
            assert_eq!(Theme::named(name).expect("embedded").style(Role::Body), Style::default());
        }
        let mono = Theme::named("mono").expect("embedded");
        assert!(Role::ALL.iter().all(|role| mono.style(*role).fg.is_none() && mono.style(*role).bg.is_none()));
    }

    #[test]
    fn a_wrong_theme_says_what_is_wrong() {
        assert!(matches!(Theme::named("\u{1b}[2J"), Err(ThemeError::Unknown(name)) if !name.contains('\u{1b}')));
        assert!(matches!(Theme::parse("name = 'x'\n[roles]\n"), Err(ThemeError::Missing(Role::Body))));
        let text = EMBEDDED[0].1.replace("#7cc7ff", "blue");
        assert!(matches!(Theme::parse(&text), Err(ThemeError::Colour(colour)) if colour == "blue"));
        let text = EMBEDDED[0].1.replace("accent", "akzent");
        assert!(matches!(Theme::parse(&text), Err(ThemeError::Syntax(_))));
        assert_eq!(Theme::name_after("mono"), "night");
    }
}
