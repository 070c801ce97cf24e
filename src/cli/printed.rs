//! Output that needs no home (defaults, completions, the manual page), the console's options, and progress of long
//! work.

use std::{convert::Infallible, fmt::Write as _, future::Future, path::Path, time::Duration};

use authros_output::Output;
use clap::CommandFactory;

use super::args::{Arguments, ConsoleArguments, PrintArguments};
use super::connect::{Context, environment};
use super::{complete, passphrase, twins::TWINS};
use crate::app::{Keymap, Settings, keymap};
use crate::model::{ErrorKind, Timestamp, clean};
use crate::service::{Client, Failure, command::RecordingProgress, reply::input};
use crate::ui::{Themes, theme};
use crate::{app::history::Progress, config::DEFINITIONS, config::Definition, paths::Home, term::ConsoleOptions};

pub fn asked_for(arguments: &PrintArguments) -> Result<Option<String>, Failure> {
    match arguments {
        PrintArguments { default_config: true, .. } => Ok(Some(config())),
        PrintArguments { default_keymap: true, .. } => Ok(Some(keymap::preset_text())),
        PrintArguments { default_theme: Some(name), .. } => {
            let text = theme::embedded_text(name).map(str::to_owned);
            let unknown =
                || format!("there is no embedded theme '{}'; choose night, day, contrast or mono", clean(name, 40));
            text.ok_or_else(|| Failure::new(ErrorKind::Usage, unknown())).map(Some)
        }
        PrintArguments { completions: Some(shell), .. } => Ok(Some(completions(*shell))),
        PrintArguments { manual: true, .. } => manual().map(Some),
        _ => Ok(None),
    }
}

fn config() -> String {
    let mut text = "# Settings of AuthROS. Precedence: option, then environment, then this file (config.toml).\n# \
                    Without any settings everything is embedded. Remove the # from what you set.\n"
        .to_owned();
    let place = |definition: &Definition| definition.name.split_once('.').unwrap_or(("", definition.name));
    // Those without a table come first.
    let mut tables = vec![""];
    for (table, _) in DEFINITIONS.iter().map(place) {
        if !tables.contains(&table) {
            tables.push(table);
        }
    }
    for table in tables {
        // Writing to a string cannot fail.
        let _ = if table.is_empty() { Ok(()) } else { write!(text, "\n[{table}]") };
        for definition in DEFINITIONS.iter().filter(|definition| place(definition).0 == table) {
            let Definition { variable, default, text: help, .. } = definition;
            let (key, value) = (place(definition).1, toml::Value::String((*default).to_owned()));
            let _ = writeln!(text, "\n# {help} ({variable})\n#{key} = {value}");
        }
    }
    text
}

pub fn completions(shell: clap_complete::Shell) -> String {
    let mut bytes = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "authros", &mut bytes);
    complete::with_words(shell, String::from_utf8_lossy(&bytes).into_owned())
}

fn manual() -> Result<String, Failure> {
    let failed = |error: std::io::Error| Failure::new(ErrorKind::Internal, format!("the manual page: {error}"));
    let mut bytes = Vec::new();
    let command = Arguments::command();
    clap_mangen::Man::new(command.clone()).render(&mut bytes).map_err(failed)?;
    let mut command = command;
    command.build();
    let mut text = String::from_utf8_lossy(&bytes).into_owned();
    commands(&mut text, &command, "authros");
    text.push_str(".SH THE CONSOLE\'S COMMANDS WITHOUT IT\n");
    for (name, line) in TWINS {
        let _ = write!(text, ".TP\n\\fB{}\\fR\nauthros {}\n", roff(name), roff(line));
    }
    Ok(text)
}

fn commands(text: &mut String, command: &clap::Command, path: &str) {
    for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set()) {
        let path = format!("{path} {}", verb.get_name());
        let about = verb.get_about().map(ToString::to_string).unwrap_or_default();
        let _ = write!(text, ".SH {}\n{}\n", roff(&path.to_uppercase()), roff(&about));
        for argument in verb.get_arguments().filter(|argument| !argument.is_global_set()) {
            let long = argument.get_long().map(|long| format!("--{long} "));
            let value = argument.get_value_names().unwrap_or_default().join(" ");
            let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
            if long.is_some() || argument.is_positional() {
                let name = format!("{}{value}", long.unwrap_or_default());
                let _ = write!(text, ".TP\n\\fB{}\\fR\n{}\n", roff(name.trim()), roff(&help));
            }
        }
        commands(text, verb, &path);
    }
}

fn roff(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-").replace('\n', " ");
    if text.starts_with(['.', '\'']) { format!("\\&{text}") } else { text }
}

/// The longest file read, bytes.
const LONGEST: u64 = 256 * 1024;

pub fn options(context: &Context, arguments: ConsoleArguments) -> Result<ConsoleOptions, Failure> {
    let (settings, owner) = (&context.config.console, context.operator.is_none());
    let given = passphrase::is_given(&context.global, &context.home, &context.profile);
    let theme = arguments.theme.or_else(|| settings.theme.clone());
    Ok(ConsoleOptions {
        settings: Settings {
            profile: context.profile.clone(),
            operator: context.operator.as_ref().map(|operator| operator.name.to_string()),
            read_only: arguments.read_only,
            keymap: keymap(&context.home)?,
            // Only the owner locks and unlocks the keyring.
            lock_after: settings.lock_after.filter(|_| owner),
            profiles: if owner { context.home.profiles() } else { Vec::new() },
            asks_passphrase: owner && !given,
            ..Settings::default()
        },
        themes: themes(&context.home, theme.as_deref())?,
        theme,
        ascii: arguments.ascii || settings.ascii.unwrap_or_else(|| !locale_has_unicode(environment)),
        mouse: settings.mouse,
        bytes_per_second: settings.bytes_per_second,
        kept: context.home.console(&context.profile),
        pictures: settings.pictures,
        warning: None,
    })
}

fn keymap(home: &Home) -> Result<Keymap, Failure> {
    let path = home.keymap();
    let Some(text) = read(&path)? else { return Ok(Keymap::default()) };
    Keymap::with_file(&path.display().to_string(), &text).map_err(|error| input(error.to_string()))
}

/// Those of the program and of the home, with the one that is wanted.
pub fn themes(home: &Home, wanted: Option<&str>) -> Result<Themes, Failure> {
    let entries = std::fs::read_dir(home.themes()).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut paths: Vec<_> = entries.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    paths.sort();
    let mut files = Vec::new();
    for path in paths {
        files.extend(read(&path)?.map(|text| (path.display().to_string(), text)));
    }
    let themes = Themes::with_files(&files).map_err(|error| input(error.to_string()))?;
    wanted.map(|name| themes.named(name)).transpose().map_err(|error| input(error.to_string()))?;
    Ok(themes)
}

fn read(path: &Path) -> Result<Option<String>, Failure> {
    let wrong = |what: String| input(format!("{}: {what}", path.display()));
    match std::fs::metadata(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(wrong(error.to_string())),
        Ok(about) if about.len() > LONGEST => return Err(wrong(format!("longer than {LONGEST} bytes"))),
        Ok(_) => {}
    }
    std::fs::read_to_string(path).map(Some).map_err(|error| wrong(error.to_string()))
}

/// Without a locale, terminals are taken to know Unicode.
fn locale_has_unicode(variable: impl Fn(&str) -> Option<String>) -> bool {
    let set = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().filter_map(variable).find(|value| !value.is_empty());
    set.is_none_or(|value| {
        let value = value.to_ascii_lowercase();
        value.contains("utf-8") || value.contains("utf8")
    })
}

pub const TAMPERED: &str =
    "authros: some records differ from what was anchored; `authros records list --state tampered` lists them";

pub const LOOK: Duration = Duration::from_secs(3);

#[derive(Debug, Default)]
pub struct Teller {
    progress: Progress,
    told: Vec<String>,
}

impl Teller {
    /// Writes only lines that were not written last.
    pub async fn tell(&mut self, client: &Client, output: &Output) {
        let Ok(runs) = client.ask(RecordingProgress).await else { return };
        let now = Timestamp::now();
        self.progress.set(runs, now);
        let lines = self.progress.lines(now);
        lines.iter().filter(|line| !self.told.contains(line)).for_each(|line| output.note(line));
        self.told = lines;
    }
}

pub async fn tell_on(client: &Client, every: Duration, output: &Output) -> Infallible {
    let mut teller = Teller::default();
    loop {
        tokio::time::sleep(every).await;
        teller.tell(client, output).await;
    }
}

pub async fn told<T>(client: &Client, work: impl Future<Output = T>, output: &Output) -> T {
    tokio::select! {
        done = work => done,
        never = tell_on(client, LOOK, output) => match never {},
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn printed(arguments: &[&str]) -> String {
        let arguments = Arguments::try_parse_from(["authros"].iter().chain(arguments)).expect("parses");
        asked_for(&arguments.print).expect("printed").expect("a text")
    }

    #[test]
    fn what_is_printed_can_be_read_back() {
        let config = printed(&["--print-default-config"]);
        for definition in DEFINITIONS {
            assert!(config.contains(definition.text) && config.contains(definition.variable), "{}", definition.name);
        }
        let set = config.replace("\n#robots", "\nrobots").replace("\n#confirmations", "\nconfirmations");
        let none = |_: &str| None;
        let read = |text: &str| crate::config::Config::resolve(&none, &none, Some((std::path::Path::new("c"), text)));
        assert_eq!((read(&config).expect("reads").robots, read(&set).expect("reads").robots), (4, 4));
        assert!(printed(&["--print-default-theme"]).contains("name = \"night\""));
        assert!(printed(&["--print-default-theme=day"]).contains("name = \"day\""));
        assert!(crate::app::Keymap::with_file("k", &printed(&["--print-default-keymap"])).is_ok());
        assert!(printed(&["--print-completions", "bash"]).contains("_authros_words"));
        assert!(printed(&["--print-manual"]).contains("AUTHROS RECORDS"));
    }

    #[test]
    fn completions_and_manual_know_every_command() {
        let manual = manual().expect("a page");
        for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
            let script = completions(clap::ValueEnum::from_str(shell, false).expect("a shell"));
            assert!(Arguments::command().get_subcommands().all(|verb| script.contains(verb.get_name())), "{shell}");
        }
        for verb in Arguments::command().get_subcommands().filter(|verb| !verb.is_hide_set()) {
            assert!(manual.contains(&format!("AUTHROS {}", verb.get_name().to_uppercase())), "{}", verb.get_name());
        }
    }
}

#[cfg(test)]
mod looks_tests {
    use super::*;

    #[test]
    fn the_first_locale_variable_that_is_set_decides() {
        let with = |pairs: &'static [(&str, &str)]| {
            locale_has_unicode(|name| {
                pairs.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
            })
        };
        assert!(with(&[]) && with(&[("LANG", "de_DE.UTF-8")]) && with(&[("LC_ALL", ""), ("LANG", "C.utf8")]));
        assert!(!with(&[("LANG", "C")]) && !with(&[("LC_ALL", "POSIX"), ("LANG", "C.UTF-8")]));
    }
}
