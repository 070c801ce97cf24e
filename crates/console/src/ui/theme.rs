//! Roles to colours. Code names only roles; the colours are in `themes/*.toml`.

mod file;

use ratatui::style::Style;
use serde::Deserialize;

use crate::model::clean;

/// The role of a piece of text.
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
    /// What stands out: names, important numbers.
    Accent,
    /// Well.
    Good,
    /// Waiting or counted.
    Warning,
    /// Wrong.
    Bad,
    /// Under the cursor.
    Selection,
    /// Lines around popups.
    Border,
    /// FROZEN, SIMULATED, the screen in view.
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

    /// Its name in a theme file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Body => "body",
            Self::Title => "title",
            Self::Dim => "dim",
            Self::Accent => "accent",
            Self::Good => "good",
            Self::Warning => "warning",
            Self::Bad => "bad",
            Self::Selection => "selection",
            Self::Border => "border",
            Self::Badge => "badge",
            Self::Key => "key",
        }
    }
}

/// Why a theme cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ThemeError {
    /// There is no theme of that name.
    #[error("there is no theme '{name}'; choose {known}")]
    Unknown {
        /// The requested name.
        name: String,
        /// The existing names.
        known: String,
    },
    /// A theme file is wrong.
    #[error("{file} line {line}: {what}")]
    File {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// What is wrong, and what to do.
        what: String,
    },
}

/// The embedded themes.
const EMBEDDED: [(&str, &str); 4] = [
    ("night", include_str!("../../../../themes/night.toml")),
    ("day", include_str!("../../../../themes/day.toml")),
    ("contrast", include_str!("../../../../themes/contrast.toml")),
    ("mono", include_str!("../../../../themes/mono.toml")),
];

/// The text of the embedded theme of that name, as a template for one's own.
pub fn embedded_text(name: &str) -> Option<&'static str> {
    EMBEDDED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// How many colours pictures may have.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Shades {
    /// As many as wanted.
    #[default]
    All,
    /// The sixteen.
    Sixteen,
    /// None: characters instead.
    None,
}

/// The style of each role.
#[derive(Debug, Clone, PartialEq)]
pub struct Theme {
    /// Its name.
    pub name: String,
    /// Draw with ASCII characters only.
    pub ascii: bool,
    /// How many colours pictures may have.
    pub shades: Shades,
    /// Whether the terminal draws pictures itself, as pixels.
    pub pixels: bool,
    /// The background the colours are made for.
    pub assumed: Option<(u8, u8, u8)>,
    styles: [Style; Role::ALL.len()],
}

impl Theme {
    /// The embedded theme of that name.
    ///
    /// # Errors
    /// [`ThemeError::Unknown`] if there is none.
    pub fn named(name: &str) -> Result<Self, ThemeError> {
        let text = embedded_text(name).ok_or_else(|| unknown(name, EMBEDDED.map(|(known, _)| known).join(", ")))?;
        file::read(name, text, &[])
    }

    /// The same theme, drawn with ASCII characters only or not.
    pub fn with_ascii(self, ascii: bool) -> Self {
        Self { ascii, ..self }
    }

    /// The same theme on a terminal with this many colours.
    pub fn with_shades(self, shades: Shades) -> Self {
        Self { shades, ..self }
    }

    /// The same theme on a terminal that draws pictures itself, or not.
    pub fn with_pixels(self, pixels: bool) -> Self {
        Self { pixels, ..self }
    }

    /// Whether pictures are left to the terminal: never in ASCII, nor without colours.
    pub fn draws_pixels(&self) -> bool {
        let colours = || self.styles.iter().any(|style| style.fg.is_some() || style.bg.is_some());
        self.pixels && !self.ascii && self.shades != Shades::None && colours()
    }

    /// The style of a role.
    pub fn style(&self, role: Role) -> Style {
        self.styles[role as usize]
    }
}

/// The available themes: the embedded ones, then the operator's own.
#[derive(Debug, Clone)]
pub struct Themes(Vec<Theme>);

impl Themes {
    /// The embedded ones and those in the operator's files (name and text). A file contains only what differs from its
    /// `base`; one with the name of an embedded theme replaces it.
    ///
    /// # Errors
    /// [`ThemeError`] naming file and line.
    pub fn with_files(files: &[(String, String)]) -> Result<Self, ThemeError> {
        let mut themes = EMBEDDED.iter().map(|(name, _)| Theme::named(name)).collect::<Result<Vec<_>, _>>()?;
        let mut from: Vec<(String, &str)> = Vec::new();
        for (file, text) in files {
            let theme = file::read(file, text, &themes)?;
            if let Some((_, other)) = from.iter().find(|(name, _)| *name == theme.name) {
                let what = format!(
                    "the theme '{}' is also in {}; give one of them another name",
                    theme.name,
                    clean(other, 200)
                );
                return Err(ThemeError::File { file: clean(file, 200), line: 1, what });
            }
            from.push((theme.name.clone(), file));
            match themes.iter_mut().find(|known| known.name == theme.name) {
                Some(known) => *known = theme,
                None => themes.push(theme),
            }
        }
        Ok(Self(themes))
    }

    /// Their names, in the order shown.
    pub fn names(&self) -> Vec<String> {
        self.0.iter().map(|theme| theme.name.clone()).collect()
    }

    /// The theme of that name.
    ///
    /// # Errors
    /// [`ThemeError::Unknown`] if there is none.
    pub fn named(&self, name: &str) -> Result<Theme, ThemeError> {
        let found = self.0.iter().find(|theme| theme.name == name).cloned();
        found.ok_or_else(|| unknown(name, self.names().join(", ")))
    }
}

fn unknown(name: &str, known: String) -> ThemeError {
    ThemeError::Unknown { name: clean(name, 40), known }
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

    fn one(text: &str) -> Result<Theme, ThemeError> {
        let files = [("mine.toml".to_owned(), text.to_owned())];
        Themes::with_files(&files).map(|themes| themes.0.last().expect("some").clone())
    }

    fn line_of(text: &str) -> (usize, String) {
        match one(text) {
            Err(ThemeError::File { file, line, what }) if file == "mine.toml" => (line, what),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_own_theme_says_only_what_differs() {
        let own = one("name = 'sea'\nbase = 'day'\n[roles]\naccent = { fg = '#003366' }\n").expect("a theme");
        let day = Theme::named("day").expect("embedded");
        assert_eq!((own.name.as_str(), own.assumed), ("sea", day.assumed));
        for role in Role::ALL {
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
        for role in Role::ALL {
            let text = format!("name = 'x'\n[roles]\n{} = {{ underline = true }}\n", role.word());
            assert!(one(&text).expect("known").style(role).add_modifier.contains(ratatui::style::Modifier::UNDERLINED));
        }
    }
}
