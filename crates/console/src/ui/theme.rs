//! Roles to colours: code names only roles, colours are in `themes/*.toml` or the operator's file.

use ratatui::style::{Color, Modifier, Style};
use serde::Deserialize;
use std::collections::BTreeMap;
use strum::{EnumCount, EnumIter, IntoEnumIterator as _, IntoStaticStr};
use toml::Spanned;

use crate::app::keymap::{FileError, Source};
use crate::model::clean;

#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, EnumCount, EnumIter, IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Role {
    /// The terminal's own colour.
    #[default]
    Body,
    Title,
    Dim,
    /// Names, important numbers.
    Accent,
    Good,
    Warning,
    Bad,
    Selection,
    Border,
    /// FROZEN, SIMULATED, the screen in view.
    Badge,
    Key,
}

impl Role {
    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ThemeError {
    #[error("there is no theme '{name}'; choose {known}")]
    Unknown { name: String, known: String },
    #[error(transparent)]
    File(#[from] FileError),
}

const EMBEDDED: [(&str, &str); 4] = [
    ("night", include_str!("../../../../themes/night.toml")),
    ("day", include_str!("../../../../themes/day.toml")),
    ("contrast", include_str!("../../../../themes/contrast.toml")),
    ("mono", include_str!("../../../../themes/mono.toml")),
];

/// A template for one's own.
pub fn embedded_text(name: &str) -> Option<&'static str> {
    EMBEDDED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Colours of the terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    True,
    Indexed,
    Sixteen,
    /// Bold, underline and reverse only.
    None,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Theme {
    pub name: String,
    pub ascii: bool,
    pub depth: Depth,
    /// The terminal draws pictures, as pixels.
    pub pixels: bool,
    /// Background the colours are made for.
    pub assumed: Option<(u8, u8, u8)>,
    pub(crate) styles: [Style; Role::COUNT],
}

impl Theme {
    pub fn named(name: &str) -> Result<Self, ThemeError> {
        let text = embedded_text(name).ok_or_else(|| unknown(name, EMBEDDED.map(|(known, _)| known).join(", ")))?;
        Ok(read(name, text, &[])?)
    }

    /// Never in ASCII, nor without colours.
    pub fn draws_pixels(&self) -> bool {
        let colours = || self.styles.iter().any(|style| style.fg.is_some() || style.bg.is_some());
        self.pixels && !self.ascii && self.depth != Depth::None && colours()
    }

    pub fn style(&self, role: Role) -> Style {
        self.styles[role as usize]
    }
}

/// Embedded ones, then the operator's.
#[derive(Debug, Clone)]
pub struct Themes(Vec<Theme>);

impl Themes {
    /// `files`: name and text. One contains only what differs from its `base`, and can replace an embedded theme.
    pub fn with_files(files: &[(String, String)]) -> Result<Self, ThemeError> {
        let mut themes = EMBEDDED.iter().map(|(name, _)| Theme::named(name)).collect::<Result<Vec<_>, _>>()?;
        let mut from: Vec<(String, &str)> = Vec::new();
        for (file, text) in files {
            let theme = read(file, text, &themes)?;
            if let Some((_, other)) = from.iter().find(|(name, _)| *name == theme.name) {
                let what = format!(
                    "the theme '{}' is also in {}; give one of them another name",
                    theme.name,
                    clean(other, 200)
                );
                return Err(Source { file, text }.wrong(0, what).into());
            }
            from.push((theme.name.clone(), file));
            match themes.iter_mut().find(|known| known.name == theme.name) {
                Some(known) => *known = theme,
                None => themes.push(theme),
            }
        }
        Ok(Self(themes))
    }

    pub fn names(&self) -> Vec<String> {
        self.0.iter().map(|theme| theme.name.clone()).collect()
    }

    pub fn named(&self, name: &str) -> Result<Theme, ThemeError> {
        let found = self.0.iter().find(|theme| theme.name == name).cloned();
        found.ok_or_else(|| unknown(name, self.names().join(", ")))
    }
}

fn unknown(name: &str, known: String) -> ThemeError {
    ThemeError::Unknown { name: clean(name, 40), known }
}

pub type Rgb = (u8, u8, u8);

/// In the order of their codes.
pub const SIXTEEN: [Rgb; 16] = [
    (0, 0, 0),
    (170, 0, 0),
    (0, 130, 0),
    (130, 90, 0),
    (0, 0, 170),
    (130, 0, 150),
    (0, 130, 130),
    (190, 190, 190),
    (100, 100, 100),
    (255, 120, 110),
    (110, 230, 110),
    (245, 220, 80),
    (100, 170, 255),
    (220, 170, 255),
    (110, 230, 255),
    (255, 255, 255),
];

/// Perceived distance.
pub fn distance(one: Rgb, other: Rgb) -> u32 {
    let part = |one: u8, other: u8, weight: u32| u32::from(one.abs_diff(other)).pow(2) * weight;
    part(one.0, other.0, 3) + part(one.1, other.1, 6) + part(one.2, other.2, 2)
}

const BASE: &str = "night";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools, reason = "each is a key of the theme file")]
struct Paint {
    fg: Option<Spanned<String>>,
    bg: Option<Spanned<String>>,
    #[serde(default)]
    bold: bool,
    #[serde(default)]
    dim: bool,
    #[serde(default)]
    underline: bool,
    #[serde(default)]
    reversed: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ThemeFile {
    name: String,
    base: Option<Spanned<String>>,
    assumed: Option<Spanned<String>>,
    #[serde(default)]
    roles: BTreeMap<Role, Paint>,
}

impl Source<'_> {
    fn rgb(&self, written: &Spanned<String>) -> Result<Rgb, FileError> {
        let text = written.get_ref();
        let wrong = || self.wrong(written.span().start, format!("'{text}' is not a colour; write #rrggbb"));
        let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6).ok_or_else(wrong)?;
        let number = u32::from_str_radix(digits, 16).map_err(|_| wrong())?;
        let [_, red, green, blue] = number.to_be_bytes();
        Ok((red, green, blue))
    }

    fn colour(&self, written: Option<&Spanned<String>>) -> Result<Option<Color>, FileError> {
        let rgb = written.map(|written| self.rgb(written)).transpose()?;
        Ok(rgb.map(|(red, green, blue)| Color::Rgb(red, green, blue)))
    }

    fn style(&self, paint: &Paint) -> Result<Style, FileError> {
        let (fg, bg) = (self.colour(paint.fg.as_ref())?, self.colour(paint.bg.as_ref())?);
        let wanted = [
            (paint.bold, Modifier::BOLD),
            (paint.dim, Modifier::DIM),
            (paint.underline, Modifier::UNDERLINED),
            (paint.reversed, Modifier::REVERSED),
        ];
        let modifiers = wanted.into_iter().filter(|(on, _)| *on).map(|(_, modifier)| modifier);
        Ok(modifiers.fold(Style { fg, bg, ..Style::default() }, Style::add_modifier))
    }
}

/// Takes the rest from its base among `known`; without a base the theme must be complete.
fn read(file: &str, text: &str, known: &[Theme]) -> Result<Theme, FileError> {
    let source = Source { file, text };
    let parsed: ThemeFile = source.parsed()?;
    let name = clean(&parsed.name, 30);
    let base = base(&source, parsed.base.as_ref(), known)?;
    let mut styles = base.map_or_else(Default::default, |base| base.styles);
    for (role, paint) in &parsed.roles {
        styles[*role as usize] = source.style(paint)?;
    }
    if let (None, Some(role)) = (base, Role::iter().find(|role| !parsed.roles.contains_key(role))) {
        return Err(source.wrong(0, format!("the theme does not define the role {}", role.word())));
    }
    let assumed = parsed.assumed.as_ref().map(|assumed| source.rgb(assumed)).transpose()?;
    let assumed = assumed.or_else(|| base.and_then(|base| base.assumed));
    Ok(Theme { name, ascii: false, depth: Depth::True, pixels: false, assumed, styles })
}

fn base<'a>(
    source: &Source,
    wanted: Option<&Spanned<String>>,
    known: &'a [Theme],
) -> Result<Option<&'a Theme>, FileError> {
    let find = |name: &str| known.iter().find(|theme| theme.name == name);
    let Some(wanted) = wanted else { return Ok(find(BASE)) };
    let missing = || source.wrong(wanted.span().start, format!("there is no theme '{}'", wanted.get_ref()));
    find(wanted.get_ref()).map(Some).ok_or_else(missing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::style::Color;

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
            for role in Role::iter() {
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
        assert!(Role::iter().all(|role| mono.style(role).fg.is_none() && mono.style(role).bg.is_none()));
    }

    fn one(text: &str) -> Result<Theme, ThemeError> {
        let files = [("mine.toml".to_owned(), text.to_owned())];
        Themes::with_files(&files).map(|themes| themes.0.last().expect("some").clone())
    }

    fn line_of(text: &str) -> (usize, String) {
        match one(text) {
            Err(ThemeError::File(FileError { file, line, what })) if file == "mine.toml" => (line, what),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_own_theme_says_only_what_differs() {
        let own = one("name = 'sea'\nbase = 'day'\n[roles]\naccent = { fg = '#003366' }\n").expect("a theme");
        let day = Theme::named("day").expect("embedded");
        assert_eq!((own.name.as_str(), own.assumed), ("sea", day.assumed));
        for role in Role::iter() {
            assert_eq!(own.style(role) == day.style(role), role != Role::Accent, "{role:?}");
        }
        let files = [("a.toml".to_owned(), "name = 'night'\n[roles]\nbody = { bold = true }\n".to_owned())];
        let themes = Themes::with_files(&files).expect("themes");
        assert_eq!(themes.names(), ["night", "day", "contrast", "mono"]);
        assert_ne!(themes.named("night").expect("there").style(Role::Body), Style::default());
        assert!(themes.named("sea").expect_err("none").to_string().contains("mono"));
    }

    #[test]
    fn a_wrong_theme_names_file_and_line() {
        assert!(matches!(Theme::named("\u{1b}[2J"), Err(ThemeError::Unknown { name, .. }) if !name.contains('\u{1b}')));
        let (line, what) = line_of("name = 'x'\n[roles]\nbody = {}\naccent = { fg = 'blue' }\n");
        assert!(line == 4 && what.contains("'blue'"), "{line} {what}");
        let (line, what) = line_of("name = 'x'\n[roles]\nakzent = { bold = true }\n");
        assert!(line == 3 && what.contains("akzent"), "{line} {what}");
        let (line, _) = line_of("name = 'x'\n[roles]\nbad = {}\nbad = {}\n");
        assert_eq!(line, 4);
        let (line, what) = line_of("name = 'x'\nbase = 'fog'\n[roles]\n");
        assert!(line == 2 && what.contains("fog"), "{line} {what}");
        let (line, what) = line_of("name = 'x'\n[roles]\nbad = { fg = '#é1234' }\n");
        assert!(line == 3 && what.contains("#rrggbb"), "{line} {what}");
        let twice = ["a", "b"].map(|file| (file.to_owned(), "name = 'x'\n".to_owned()));
        assert!(Themes::with_files(&twice).expect_err("twice").to_string().starts_with("b line 1"));
    }

    #[test]
    fn every_role_has_its_word() {
        for role in Role::iter() {
            let text = format!("name = 'x'\n[roles]\n{} = {{ underline = true }}\n", role.word());
            assert!(one(&text).expect("known").style(role).add_modifier.contains(ratatui::style::Modifier::UNDERLINED));
        }
    }
}
