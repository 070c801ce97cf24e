//! A theme file: its name, its base, and the roles with another style.

use std::collections::BTreeMap;

use ratatui::style::{Color, Modifier, Style};
use serde::Deserialize;
use toml::Spanned;

use super::{Role, Shades, Theme, ThemeError};
use crate::model::clean;

/// The default base of an operator's theme.
const BASE: &str = "night";

/// The style of one role, as written.
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

struct Source<'a> {
    file: &'a str,
    text: &'a str,
}

impl Source<'_> {
    fn wrong(&self, at: usize, what: impl Into<String>) -> ThemeError {
        let line = self.text.get(..at).map_or(1, |before| before.matches('\n').count() + 1);
        ThemeError::File { file: clean(self.file, 200), line, what: clean(&what.into(), 300) }
    }

    fn rgb(&self, written: &Spanned<String>) -> Result<(u8, u8, u8), ThemeError> {
        let text = written.get_ref();
        let wrong = || self.wrong(written.span().start, format!("'{text}' is not a colour; write #rrggbb"));
        let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6).ok_or_else(wrong)?;
        let number = u32::from_str_radix(digits, 16).map_err(|_| wrong())?;
        let [_, red, green, blue] = number.to_be_bytes();
        Ok((red, green, blue))
    }

    fn colour(&self, written: Option<&Spanned<String>>) -> Result<Option<Color>, ThemeError> {
        let rgb = written.map(|written| self.rgb(written)).transpose()?;
        Ok(rgb.map(|(red, green, blue)| Color::Rgb(red, green, blue)))
    }

    fn style(&self, paint: &Paint) -> Result<Style, ThemeError> {
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

/// A theme from the text of its file; what it does not name is as in its base among `known`. If none is known, it must
/// be complete.
pub fn read(file: &str, text: &str, known: &[Theme]) -> Result<Theme, ThemeError> {
    let source = Source { file, text };
    let parsed: ThemeFile = toml::from_str(text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        source.wrong(at, error.message().trim().replace('\n', "; "))
    })?;
    let name = clean(&parsed.name, 30);
    let base = base(&source, parsed.base.as_ref(), known)?;
    let mut styles = base.map_or_else(Default::default, |base| base.styles);
    for (role, paint) in &parsed.roles {
        styles[*role as usize] = source.style(paint)?;
    }
    if let (None, Some(role)) = (base, Role::ALL.into_iter().find(|role| !parsed.roles.contains_key(role))) {
        return Err(source.wrong(0, format!("the theme does not define the role {}", role.word())));
    }
    let assumed = parsed.assumed.as_ref().map(|assumed| source.rgb(assumed)).transpose()?;
    let assumed = assumed.or_else(|| base.and_then(|base| base.assumed));
    Ok(Theme { name, ascii: false, shades: Shades::All, pixels: false, assumed, styles })
}

fn base<'a>(
    source: &Source,
    wanted: Option<&Spanned<String>>,
    known: &'a [Theme],
) -> Result<Option<&'a Theme>, ThemeError> {
    let find = |name: &str| known.iter().find(|theme| theme.name == name);
    let Some(wanted) = wanted else { return Ok(find(BASE)) };
    let found = find(wanted.get_ref());
    found
        .map(Some)
        .ok_or_else(|| source.wrong(wanted.span().start, format!("there is no theme '{}'", wanted.get_ref())))
}
