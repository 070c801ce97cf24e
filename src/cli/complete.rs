//! Completion of words that only the home knows: the shells' scripts ask the hidden `complete`.

use std::fmt::Write as _;

use clap_complete::Shell;

use super::args::Global;
use crate::paths::Home;
use crate::service::completing::{self, Completed};

/// Commands, and the kind of their first argument.
const COMMANDS: &[(&str, Completed)] = &[
    ("topics watch", Completed::Topic),
    ("topics unwatch", Completed::Topic),
    ("topics pin", Completed::Topic),
    ("topics unpin", Completed::Topic),
    ("topics coverage", Completed::Topic),
    ("grant add", Completed::Contact),
    ("grant end", Completed::Contact),
    ("grant extend", Completed::Contact),
    ("contacts remove", Completed::Contact),
    ("contacts confirm", Completed::Contact),
    ("records show", Completed::Record),
    ("records export", Completed::Record),
    ("records check", Completed::Record),
    ("records open", Completed::Record),
    ("records path", Completed::Record),
];

/// Options of every command, and the kind of their value.
const OPTIONS: &[(&str, Completed)] = &[
    ("topic", Completed::Topic),
    ("reveal-topic", Completed::Topic),
    ("owner", Completed::Contact),
    ("to", Completed::Contact),
    ("account", Completed::Contact),
    ("profile", Completed::Profile),
];

pub fn candidates(global: &Global, what: Completed, begun: &str) -> String {
    let home = global.home.clone().map_or_else(Home::standard, |root| Ok(Home::new(root)));
    let Ok(home) = home else { return String::new() };
    completing::words(&home, what, begun).into_iter().map(|word| word + "\n").collect()
}

pub fn with_words(shell: Shell, script: String) -> String {
    match shell {
        Shell::Bash => format!("{script}\n{}", BASH.replace("LOOP", &before("COMP_WORDS", "COMP_CWORD", "1"))),
        // Once loaded, zsh calls `_authros` by its name.
        Shell::Zsh => {
            let script = script.replacen("_authros() {", "_authros_commands_alone() {", 1);
            let head = ZSH.replace("LOOP", &before("words", "CURRENT", "2"));
            script.replacen("_authros_commands_alone() {", &format!("{head}\n_authros_commands_alone() {{"), 1)
        }
        Shell::Fish => format!("{script}\n{}", fish()),
        _ => script,
    }
}

fn name(word: Completed) -> &'static str {
    word.into()
}

fn cases() -> String {
    let mut text = String::new();
    for (option, word) in OPTIONS {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "        *\" --{option} \") what={} ;;", name(*word));
    }
    for (path, word) in COMMANDS {
        let _ = writeln!(text, "        \" {path} \") what={} ;;", name(*word));
    }
    text
}

/// `before` holds the words before the cursor, without global flags.
const LOOP: &str = r#"    local begun="${WORDS[AT]}" before=" " what="" home="" place word
    for ((place = FIRST; place < AT; place++)); do
        word="${WORDS[place]}"
        case "$word" in
            --home) home="${WORDS[place + 1]}"; ((place++)) ;;
            --json) ;;
            --profile) if ((place + 1 < AT)); then ((place++)); else before="$before$word "; fi ;;
            *) before="$before$word " ;;
        esac
    done
    case "$before" in
CASES    esac
    if [[ -n "$what" && "$begun" != -* ]]; then
"#;

const BASH: &str = r#"_authros_words() {
LOOP        mapfile -t COMPREPLY < <(AUTHROS_HOME="${home:-$AUTHROS_HOME}" authros complete "$what" "$begun" 2>/dev/null)
        ((${#COMPREPLY[@]} == 0)) || mapfile -t COMPREPLY < <(printf '%q\n' "${COMPREPLY[@]}")
    else
        _authros "$@"
    fi
}
complete -F _authros_words -o nosort -o bashdefault -o default authros 2>/dev/null || complete -F _authros_words -o bashdefault -o default authros
"#;

/// The loop over a shell's array of words, from `first` to the cursor `at`.
fn before(words: &str, at: &str, first: &str) -> String {
    LOOP.replace("WORDS", words).replace("AT", at).replace("FIRST", first).replace("CASES", &cases())
}

const ZSH: &str = r#"_authros() {
LOOP        local -a found
        found=("${(@f)$(AUTHROS_HOME="${home:-$AUTHROS_HOME}" authros complete "$what" "$begun" 2>/dev/null)}")
        compadd -a found
    else
        _authros_commands_alone "$@"
    fi
}
"#;

fn fish() -> String {
    let ask = |word| format!("(authros complete {} (commandline -ct) 2>/dev/null)", name(word));
    let mut text = String::new();
    for (path, word) in COMMANDS {
        let seen: Vec<String> = path.split(' ').map(|verb| format!("__fish_seen_subcommand_from {verb}")).collect();
        let _ = writeln!(text, "complete -c authros -n \"{}\" -f -a \"{}\"", seen.join("; and "), ask(*word));
    }
    for (option, word) in OPTIONS {
        let _ = writeln!(text, "complete -c authros -l {option} -x -a \"{}\"", ask(*word));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::args::Arguments;
    use clap::CommandFactory;

    fn has(command: &clap::Command, option: &str) -> bool {
        let own = command.get_arguments().any(|argument| argument.get_long() == Some(option));
        own || command.get_subcommands().any(|verb| has(verb, option))
    }

    #[test]
    fn each_command_and_option_that_is_completed_is_one() {
        let mut all = Arguments::command();
        all.build();
        for (path, _) in COMMANDS {
            let mut command = &all;
            for verb in path.split(' ') {
                command = command.find_subcommand(verb).expect(path);
            }
            assert!(command.get_positionals().next().is_some(), "{path} takes no word");
        }
        assert!(OPTIONS.iter().all(|(option, _)| has(&all, option)));
    }

    #[test]
    fn each_script_asks_for_the_words() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = crate::cli::printed::completions(shell);
            assert!(script.contains("authros complete"), "{shell}");
            assert!(!script.contains("CASES"), "{shell}");
        }
        let zsh = crate::cli::printed::completions(Shell::Zsh);
        assert_eq!(zsh.matches("\n_authros() {").count(), 1, "the wrapper alone has the name");
        assert!(zsh.contains("_authros_commands_alone() {"));
    }
}
