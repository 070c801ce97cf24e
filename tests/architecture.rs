//! The house rules for the source: order of rooms, size of files, where `unsafe` is allowed, names and openings.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates in their order: each may depend only on crates before it. The last is the binary's own.
const CRATES: [&str; 19] = [
    "model", "tls", "fault", "crypto", "evidence", "pipe", "keyless", "ros2", "rosrust", "ros", "chain", "store",
    "gateway", "pipeline", "config", "service", "console", "output", "authros",
];
/// The longest file, lines.
const LONGEST: usize = 800;
/// The longest opening, lines; the map of the screen may be longer.
const LONGEST_OPENING: usize = 6;
const OPENS_WITH_A_MAP: &str = "crates/console/src/ui/mod.rs";
/// Where requests, answers, verbs and tags are dispatched: forgetting a new one there must not compile.
const DISPATCH: [&str; 19] = [
    "crates/service/src/site/handle.rs",
    "crates/console/src/app/acts.rs",
    "crates/console/src/app/answer.rs",
    "crates/console/src/app/available.rs",
    "crates/console/src/app/identity_path.rs",
    "crates/console/src/app/verb.rs",
    "crates/console/src/popups/mod.rs",
    "crates/console/src/screens/chain/keys.rs",
    "src/cli/audit.rs",
    "src/cli/chain.rs",
    "src/cli/gateway.rs",
    "src/cli/grants.rs",
    "src/cli/identity.rs",
    "src/cli/keys.rs",
    "src/cli/mod.rs",
    "src/cli/records.rs",
    "src/cli/robots.rs",
    "src/cli/settings.rs",
    "src/cli/topics.rs",
];
/// The most public functions of one store of the ledger.
const MOST_OF_A_STORE: usize = 30;
/// What is done with a ledger as a whole; all else is a store's.
const OF_THE_LEDGER: [&str; 9] = [
    "check_version",
    "open",
    "open_in_place",
    "on_server",
    "on_server_of",
    "renew_on_server",
    "restored_meanwhile",
    "path",
    "close",
];
/// The only files of the store that may name an engine of its database: those of the engines, and what works on files.
const ENGINES: [&str; 5] = ["sql", "database.rs", "snapshot.rs", "error.rs", "sql.rs"];
/// Names that say nothing.
const EMPTY_NAMES: [&str; 7] = ["util", "utils", "helper", "helpers", "manager", "misc", "common"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every Rust file below a folder of the checkout, as paths from its root.
fn rust_files(folder: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut waiting = vec![root().join(folder)];
    while let Some(directory) = waiting.pop() {
        for entry in fs::read_dir(&directory).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                waiting.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path.strip_prefix(root()).expect("below the root").to_owned());
            }
        }
    }
    found.sort();
    found
}

fn read(path: &Path) -> String {
    fs::read_to_string(root().join(path)).expect("a readable source file")
}

/// The code alone: comments and string literals are removed, lines stay.
fn code_only(source: &str) -> String {
    let mut code = String::with_capacity(source.len());
    let mut rest = source;
    while let Some(first) = rest.chars().next() {
        let length = skipped_length(rest, code.chars().next_back());
        if length > 0 {
            code.extend(rest[..length].chars().filter(|&character| character == '\n'));
            code.push(' ');
            rest = &rest[length..];
        } else {
            code.push(first);
            rest = &rest[first.len_utf8()..];
        }
    }
    code
}

/// Length of the comment or literal at the start of `rest`; 0 if there is none.
fn skipped_length(rest: &str, before: Option<char>) -> usize {
    let in_word = before.is_some_and(|character| character.is_alphanumeric() || character == '_');
    let until = |start: usize, end: &str| rest[start..].find(end).map_or(rest.len(), |found| start + found + end.len());
    if rest.starts_with("//") {
        return rest.find('\n').unwrap_or(rest.len());
    }
    if rest.starts_with("/*") {
        return until(2, "*/");
    }
    if rest.starts_with('r') && !in_word {
        let hashes = rest[1..].bytes().take_while(|&byte| byte == b'#').count();
        if rest[1 + hashes..].starts_with('"') {
            return until(2 + hashes, &format!("\"{}", "#".repeat(hashes)));
        }
    }
    if rest.starts_with('"') {
        return quoted_length(rest, '"');
    }
    // A lifetime has no second quote right after its first character.
    let characters: Vec<char> = rest.chars().take(3).collect();
    match characters[..] {
        ['\'', '\\', _] => quoted_length(rest, '\''),
        ['\'', character, '\''] => 2 + character.len_utf8(),
        _ => 0,
    }
}

fn quoted_length(rest: &str, quote: char) -> usize {
    let mut escaped = true;
    for (index, character) in rest.char_indices() {
        if character == quote && !escaped {
            return index + 1;
        }
        escaped = character == '\\' && !escaped;
    }
    rest.len()
}

/// The first words after every `crate::`, including grouped imports.
fn crate_names(code: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (index, found) in code.match_indices("crate::") {
        let before = code[..index].chars().next_back();
        if before.is_some_and(|character| character.is_alphanumeric() || "_$".contains(character)) {
            continue;
        }
        let rest = &code[index + found.len()..];
        match rest.strip_prefix('{') {
            Some(group) => names.extend(group_names(group)),
            None => names.push(word(rest)),
        }
    }
    names
}

fn group_names(group: &str) -> Vec<String> {
    let mut depth = 0;
    let mut names = vec![word(group.trim_start())];
    for (index, character) in group.char_indices() {
        match character {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => names.push(word(group[index + 1..].trim_start())),
            _ => {}
        }
    }
    names.retain(|name| !name.is_empty());
    names
}

fn word(text: &str) -> String {
    text.chars().take_while(|&character| character.is_alphanumeric() || character == '_').collect()
}

/// The paths of a `use`: `a::{b, c::d}` names `a::b` and `a::c::d`.
fn paths(tree: &str) -> Vec<String> {
    let Some((head, rest)) = tree.split_once('{') else {
        return vec![tree.split(" as ").next().unwrap_or_default().trim().to_owned()];
    };
    let group = rest.rsplit_once('}').map_or(rest, |(group, _)| group);
    let (mut depth, mut parts) = (0, vec![String::new()]);
    for character in group.chars() {
        depth += i32::from(character == '{') - i32::from(character == '}');
        match parts.last_mut() {
            Some(part) if character != ',' || depth > 0 => part.push(character),
            _ => parts.push(String::new()),
        }
    }
    let parts = parts.iter().map(|part| part.trim()).filter(|part| !part.is_empty());
    parts.flat_map(paths).map(|path| format!("{}{path}", head.trim())).collect()
}

/// The paths that a file imports, and those in the rest of its code, both without its tests.
fn paths_in(source: &str) -> (Vec<String>, Vec<String>) {
    // A visibility uses nothing.
    let code = code_only(source).replace("(in crate::", "(");
    let code = code.split("\n#[cfg(test)]").next().unwrap_or_default();
    let (mut imported, mut named) = (Vec::new(), Vec::new());
    for statement in code.split_inclusive(';') {
        let is_import = |at: &usize| {
            let before = statement[..*at].rsplit('\n').next().unwrap_or_default().trim();
            before.is_empty() || before.starts_with("pub")
        };
        let import = statement.match_indices("use ").map(|(at, _)| at).find(is_import);
        let (body, import) = statement.split_at(import.unwrap_or(statement.len()));
        imported.extend(import.strip_prefix("use ").into_iter().flat_map(|tree| paths(tree.trim_end_matches(';'))));
        let tokens = body.split(|character: char| !(character.is_alphanumeric() || "_:".contains(character)));
        named.extend(tokens.filter(|token| token.contains("::")).map(str::to_owned));
    }
    (imported, named)
}

/// A path in full, if it begins with a name that is imported.
fn in_full(path: &str, imported: &[String]) -> String {
    let (first, rest) = path.split_once("::").unwrap_or((path, ""));
    let mut imports = imported.iter().map(|import| import.trim_end_matches("::self"));
    let import = imports.find(|import| import.rsplit("::").next() == Some(first));
    import.map_or_else(|| path.to_owned(), |import| format!("{import}::{rest}"))
}

/// The module that a path in the module `own` leads to, if it is another of these.
fn module_of(path: &str, own: &str, modules: &BTreeSet<String>) -> Option<String> {
    let (mut at, mut parts) = (own.to_owned(), path.split("::").peekable());
    while let Some(part) = parts.next_if(|part| ["crate", "self", "super"].contains(part)) {
        at = match part {
            "super" => at.rsplit_once("::").map_or(String::new(), |(above, _)| above.to_owned()),
            "crate" => String::new(),
            _ => at,
        };
    }
    for part in parts {
        let below = if at.is_empty() { part.to_owned() } else { format!("{at}::{part}") };
        if !modules.contains(&below) {
            break;
        }
        at = below;
    }
    (at != own && modules.contains(&at)).then_some(at)
}

/// Of each module of the console, the others that it uses.
fn uses_in_the_console() -> BTreeMap<String, BTreeSet<String>> {
    let is_test = |path: &Path| path.iter().any(|part| part == "tests" || part == "tests.rs");
    let module = |path: &Path| {
        let name =
            path.with_extension("").iter().skip(3).map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("::");
        name.strip_suffix("::mod").unwrap_or(&name).to_owned()
    };
    let files = rust_files("crates/console/src").into_iter().filter(|path| !is_test(path));
    let files: BTreeMap<String, PathBuf> = files.map(|path| (module(&path), path)).collect();
    // A folder without a file of its own is a step of paths alone.
    let folders = files.keys().flat_map(|name| name.match_indices("::").map(|(end, _)| name[..end].to_owned()));
    let modules: BTreeSet<String> = files.keys().cloned().chain(folders).collect();
    let used = |own: &str, path: &Path| {
        let (imported, named) = paths_in(&read(path));
        let named = named.iter().map(|path| in_full(path, &imported)).collect::<Vec<_>>();
        imported.iter().chain(&named).filter_map(|path| module_of(path, own, &modules)).collect::<BTreeSet<_>>()
    };
    files.iter().map(|(own, path)| (own.clone(), used(own, path))).collect()
}

/// The sets of modules of which each uses each other, itself or through others.
fn circles(uses: &BTreeMap<String, BTreeSet<String>>) -> BTreeSet<BTreeSet<String>> {
    let reach = |own: &String| {
        let (mut reached, mut waiting) = (BTreeSet::new(), vec![own]);
        while let Some(used) = waiting.pop() {
            waiting.extend(uses.get(used).into_iter().flatten().filter(|next| reached.insert((*next).clone())));
        }
        reached
    };
    let reached: BTreeMap<String, BTreeSet<String>> = uses.keys().map(|own| (own.clone(), reach(own))).collect();
    let goes_back = |from: &String, to: &String| reached.get(from).is_some_and(|reached| reached.contains(to));
    let circle = |own: &String| -> BTreeSet<String> {
        reached[own].iter().filter(|other| goes_back(other, own)).cloned().collect()
    };
    uses.keys().map(circle).filter(|circle| !circle.is_empty()).collect()
}

/// The words of the code, for searching whole words.
fn words(code: &str) -> impl Iterator<Item = &str> {
    code.split(|character: char| !(character.is_alphanumeric() || character == '_'))
}

/// The sources of the product.
fn product() -> Vec<PathBuf> {
    ["src", "crates"].into_iter().flat_map(rust_files).collect()
}

/// The manifest of a crate of the product.
fn manifest(name: &str) -> String {
    let folder = if name == "authros" { PathBuf::new() } else { Path::new("crates").join(name) };
    read(&folder.join("Cargo.toml"))
}

/// The workspace crates that a crate depends on, according to its manifest.
fn dependencies(name: &str) -> Vec<String> {
    let manifest = manifest(name);
    let own = manifest.split_once("\n[dependencies]\n").map_or("", |(_, rest)| rest);
    let own = own.split("\n[").next().unwrap_or_default();
    own.lines().filter_map(|line| Some(word(line.strip_prefix("authros-")?))).collect()
}

/// The packages of the lock file, `name version`, and what each depends on, for all targets and with its tests.
fn locked() -> BTreeMap<String, Vec<String>> {
    let lock = read(Path::new("Cargo.lock"));
    let quoted = |line: &str, key: &str| Some(line.strip_prefix(key)?.trim_matches('"').to_owned());
    let package = |block: &str| {
        let name = block.lines().find_map(|line| quoted(line, "name = "))?;
        let version = block.lines().find_map(|line| quoted(line, "version = "))?;
        let needed =
            block.lines().filter_map(|line| Some(line.strip_prefix(" \"")?.trim_end_matches("\",").to_owned()));
        Some((format!("{name} {version}"), needed.collect()))
    };
    lock.split("[[package]]").filter_map(package).collect()
}

/// All that a package of ours depends on, and what that depends on.
fn reached(name: &str) -> BTreeSet<String> {
    let locked = locked();
    // A version stands in the lock file only where there are several.
    let found = |needed: &str| {
        let is_it = |key: &&String| **key == needed || key.split(' ').next() == Some(needed);
        locked.keys().find(is_it).cloned().unwrap_or_else(|| panic!("{needed} is not locked"))
    };
    let (mut reached, mut waiting) = (BTreeSet::new(), vec![found(name)]);
    while let Some(key) = waiting.pop() {
        if reached.insert(key.clone()) {
            waiting.extend(locked[&key].iter().map(|needed| found(needed)));
        }
    }
    reached
}

fn assert_none(what: &str, found: &[String]) {
    assert!(found.is_empty(), "{what}:\n  {}", found.join("\n  "));
}

#[test]
fn every_crate_depends_only_on_crates_before_it() {
    let mut wrong = Vec::new();
    for (place, user) in CRATES.iter().enumerate() {
        let known = |used: &String| CRATES[..place].contains(&used.as_str());
        let against = dependencies(user).into_iter().filter(|used| !known(used));
        wrong.extend(against.map(|used| format!("{user} depends on {used}")));
    }
    assert_none("against the order of crates", &wrong);
    assert!(dependencies("crypto").contains(&"model".to_owned()) && dependencies("model").is_empty());
}

#[test]
fn the_crates_are_drawn_as_they_depend_on_each_other() {
    let widest = CRATES.iter().map(|name| name.len()).max().unwrap_or_default();
    let drawn: String = CRATES.iter().fold(String::new(), |drawn, name| {
        let needed = dependencies(name);
        let in_order = CRATES.iter().filter(|other| needed.iter().any(|one| one == *other)).copied();
        let line = format!("    {name:widest$}  {}", in_order.collect::<Vec<_>>().join(" "));
        drawn + line.trim_end() + "\n"
    });
    assert!(read(Path::new("ARCHITECTURE.md")).contains(&drawn), "ARCHITECTURE.md should have:\n{drawn}");
}

#[test]
fn the_chain_s_libraries_are_built_only_where_the_chain_is() {
    let mut wrong = Vec::new();
    for name in
        ["model", "tls", "fault", "crypto", "evidence", "pipe", "keyless", "ros2", "rosrust", "ros", "store", "gateway"]
    {
        let (mut below, mut waiting) = (BTreeSet::new(), dependencies(name));
        while let Some(one) = waiting.pop() {
            waiting.extend(dependencies(&one));
            below.insert(one);
        }
        wrong.extend(below.contains("chain").then(|| format!("{name} builds it")));
        let named = ["ethers", "revm", "alloy"].into_iter();
        let own = manifest(name).split("\n[dev-dependencies]").next().unwrap_or_default().to_owned();
        wrong.extend(named.filter(|one| own.contains(&format!("\n{one}"))).map(|one| format!("{name} names {one}")));
    }
    assert_none("ethers and revm outside the chain", &wrong);
}

#[test]
fn nothing_of_the_product_depends_on_a_lab() {
    let folders = fs::read_dir(root().join("labs")).expect("labs").flatten();
    let labs: Vec<String> = folders.map(|entry| format!("authros-{}", entry.file_name().to_string_lossy())).collect();
    assert!(labs.contains(&"authros-bench".to_owned()) && labs.contains(&"authros-fuzz".to_owned()), "{labs:?}");
    let mut wrong = Vec::new();
    for user in CRATES {
        // For its tests neither.
        let named = manifest(user)
            .lines()
            .filter_map(|line| line.split(['.', ' ', '=']).next().map(str::to_owned))
            .collect::<Vec<_>>();
        wrong.extend(labs.iter().filter(|lab| named.contains(lab)).map(|lab| format!("{user} depends on {lab}")));
    }
    assert_none("on what is never shipped", &wrong);
}

#[test]
fn every_folder_of_crates_is_in_the_order() {
    let folders = fs::read_dir(root().join("crates")).expect("crates").flatten();
    let names = folders.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let strange: Vec<_> = names.filter(|name| !CRATES.contains(&name.as_str())).collect();
    assert_none("not in the list of crates", &strange);
}

#[test]
fn nothing_in_the_console_but_the_terminals_own_room_knows_the_terminal() {
    let mut wrong = Vec::new();
    for path in rust_files("crates/console/src").into_iter().filter(|path| path.iter().nth(3) != Some("term".as_ref()))
    {
        let code = code_only(&read(&path));
        let terminal = crate_names(&code).contains(&"term".to_owned());
        if terminal || words(&code).any(|word| ["crossterm", "signal_hook", "rustix"].contains(&word)) {
            wrong.push(path.display().to_string());
        }
    }
    assert_none("with the terminal", &wrong);
}

/// A screen or a popup can be read, and changed, with what it uses and without what uses it.
#[test]
fn no_files_of_the_console_use_each_other_in_a_circle() {
    let uses = uses_in_the_console();
    let knots: Vec<String> = circles(&uses).iter().map(|circle| format!("{circle:?}")).collect();
    assert_none("in a circle", &knots);
    let has = |own: &str, used: &str| uses[own].contains(used);
    assert!(
        has("ui::draw", "screens") && has("screens", "screens::topics::draw") && has("app::state", "popups::state")
    );
    assert!(has("app::acts", "screens::records::keys"), "through the import of its folder");
    let set = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    let knot = [("a", set(&["b"])), ("b", set(&["c"])), ("c", set(&["a"])), ("d", set(&["a"]))];
    let knot = knot.map(|(own, used)| (own.to_owned(), used)).into();
    assert_eq!(circles(&knot), [set(&["a", "b", "c"])].into(), "d is outside");
}

#[test]
fn nothing_falls_through_where_requests_answers_and_verbs_are_told_apart() {
    let mut wrong = Vec::new();
    for path in DISPATCH {
        let code = code_only(&read(Path::new(path)));
        if !code.contains("[deny(clippy::wildcard_enum_match_arm)]") {
            wrong.push(format!("{path} does not deny clippy::wildcard_enum_match_arm"));
        }
        wrong.extend(code.lines().filter(|line| catches_all(line)).map(|line| format!("{path}: {}", line.trim())));
    }
    assert_none("arms that catch what is not named", &wrong);
    assert!(catches_all("    _ => {}") && catches_all("other => again(other),"));
    assert!(!catches_all("Some(_) => {}") && !catches_all("Verb::Keys(verb) => keys(verb),"));
}

#[test]
fn rights_are_decided_in_one_place() {
    let mut found = Vec::new();
    for path in product().into_iter().filter(|path| !path.to_string_lossy().contains("/pipeline/src/")) {
        let code = code_only(&read(&path));
        for question in [".suspended_at(", "grant.is_active("] {
            let times = code.matches(question).count();
            found.extend((times > 0).then(|| format!("{} asks {question}", path.display())));
        }
    }
    assert_none("who may sign and read is asked of pipeline::authority", &found);
}

/// What a store asks runs on a file and on a server alike.
#[test]
fn stores_name_no_engine_of_their_database() {
    let names_one = |code: &str| ["rusqlite", "tokio_postgres"].into_iter().find(|engine| code.contains(engine));
    let mut wrong = Vec::new();
    for path in rust_files("crates/store/src") {
        let within = path.strip_prefix("crates/store/src").expect("below");
        let is_engine = within.iter().next().is_some_and(|first| ENGINES.iter().any(|engine| first == *engine));
        let is_test = path.iter().any(|part| part == "tests" || part == "tests.rs");
        let code = code_only(&read(&path));
        let code = code.split("#[cfg(test)]").next().unwrap_or_default();
        if let Some(engine) = names_one(code).filter(|_| !is_engine && !is_test) {
            wrong.push(format!("{} names {engine}", path.display()));
        }
    }
    assert_none("engines are behind crate::sql", &wrong);
    assert!(names_one(&read(Path::new("crates/store/src/sql/sqlite.rs"))).is_some());
}

/// Whether a line begins a catch-all arm.
fn catches_all(line: &str) -> bool {
    let Some((pattern, _)) = line.trim_start().split_once(" =>") else { return false };
    !pattern.is_empty() && pattern.chars().all(|character| character.is_ascii_lowercase() || character == '_')
}

/// The public functions of each type, by its name, from all of its `impl` blocks.
fn public_functions(sources: &[String]) -> BTreeMap<String, Vec<String>> {
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for source in sources {
        let mut owner = None;
        for line in source.lines() {
            if let Some(rest) = line.strip_prefix("impl ") {
                owner = Some(word(rest)).filter(|_| !rest.contains(" for "));
            } else if line == "}" {
                owner = None;
            } else if let (Some(owner), Some(function)) = (&owner, line.strip_prefix("    pub ")) {
                let name = function.split_once("fn ").map(|(_, rest)| word(rest));
                found.entry(owner.clone()).or_default().extend(name);
            }
        }
    }
    found
}

/// A feature gets the stores that it needs, so a store must not become the ledger again, and the ledger nothing but their owner.
#[test]
fn stores_are_narrow_and_the_ledger_only_opens_and_closes_them() {
    let sources: Vec<String> = rust_files("crates/store/src").iter().map(|path| code_only(&read(path))).collect();
    let functions = public_functions(&sources);
    let ledger = code_only(&read(Path::new("crates/store/src/ledger.rs")));
    let listed =
        ledger.split_once("\nstores! {").and_then(|(_, rest)| rest.split_once('}')).expect("a list of the stores").0;
    let stores: Vec<String> = listed.split(';').filter_map(|line| Some(word(line.split_once(": ")?.1))).collect();
    assert!(stores.len() >= 20 && stores.contains(&"Records".to_owned()), "{stores:?}");
    let large = stores.iter().filter(|store| functions[*store].len() > MOST_OF_A_STORE);
    assert_none(
        "too many public functions",
        &large.map(|store| format!("{store}: {:?}", functions[store])).collect::<Vec<_>>(),
    );
    let more = functions["Ledger"].iter().filter(|name| !OF_THE_LEDGER.contains(&name.as_str()));
    assert_none("functions of the ledger that belong to a store", &more.cloned().collect::<Vec<_>>());
}

#[test]
fn no_file_is_longer_than_800_lines() {
    let mut long = Vec::new();
    for path in ["src", "crates", "tests", "labs"].into_iter().flat_map(rust_files) {
        let lines = read(&path).lines().count();
        if lines > LONGEST {
            long.push(format!("{} has {lines} lines", path.display()));
        }
    }
    assert_none("longer than 800 lines", &long);
}

#[test]
fn unsafe_code_is_in_the_crypto_kernel_and_in_one_setting_of_the_allocator() {
    let setting = Path::new("src/cli/memory.rs");
    let outside = |path: &PathBuf| !path.starts_with("crates/crypto/src/kernel") && path != setting;
    let uses = |path: &PathBuf| words(&code_only(&read(path))).any(|word| word == "unsafe");
    let found: Vec<_> = product().into_iter().filter(outside).filter(uses).collect();
    assert_none(
        "unsafe outside crates/crypto/src/kernel",
        &found.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
    );
    assert_eq!(words(&code_only(&read(setting))).filter(|word| *word == "unsafe").count(), 1, "one call, no more");
}

/// rosrust's HTTP has known advisories, and rustdds parses what the network sends.
#[test]
fn what_speaks_with_the_network_in_a_program_of_its_own_is_not_in_the_one_with_keys() {
    let is = |package: &String, name: &str| package.split(' ').next() == Some(name);
    let (site, rosrust, ros2) = (reached("authros"), reached("authros-rosrust"), reached("authros-ros2"));
    let old = |package: &String| package.starts_with("hyper 0.10.");
    assert!(rosrust.iter().any(old) && ros2.iter().any(|package| is(package, "rustdds")), "it is where it is used");
    assert!(site.iter().any(|package| is(package, "ethers-core")), "the walk finds what is deep in the tree");
    let foreign = ["rosrust", "xml-rpc", "rouille", "rustdds", "authros-rosrust", "authros-ros2", "authros-keyless"];
    let held = |package: &&String| old(package) || foreign.iter().any(|name| is(package, name));
    assert_none("in the program that has keys", &site.iter().filter(held).cloned().collect::<Vec<_>>());
    let ours = |package: &&String| package.starts_with("authros-");
    for (program, packages) in [("authros-rosrust", rosrust), ("authros-ros2", ros2)] {
        let allowed = [program, "authros-keyless", "authros-pipe"];
        let strange = packages.iter().filter(ours).filter(|package| !allowed.iter().any(|name| is(package, name)));
        assert_none("in a program without keys", &strange.cloned().collect::<Vec<_>>());
    }
}

#[test]
fn every_advisory_that_is_ignored_has_its_reason() {
    let text = read(Path::new("deny.toml"));
    let named: Vec<&str> = text.lines().filter(|line| line.contains("RUSTSEC-")).collect();
    let without = named.iter().filter(|line| line.split("reason = \"").nth(1).is_none_or(|reason| reason.len() < 20));
    assert_none("without a reason", &without.map(|line| (*line).to_owned()).collect::<Vec<_>>());
    assert!(named.iter().filter(|line| line.contains("authros-rosrust")).count() > 5, "those of rosrust's tree");
}

#[test]
fn no_file_or_module_has_an_empty_name() {
    let mut empty = Vec::new();
    for path in ["src", "crates", "tests", "labs"].into_iter().flat_map(rust_files) {
        for part in path.iter().filter_map(|part| part.to_str()) {
            if part.trim_end_matches(".rs").split('_').any(|word| EMPTY_NAMES.contains(&word)) {
                empty.push(path.display().to_string());
            }
        }
    }
    assert_none("names that say nothing", &empty);
}

/// The sample of a whole home, which nothing compresses.
const BACKUP: &str = "tests/format1/site.backup";

/// A wheel of a hundred megabytes once got into the repository through `git add`.
#[test]
fn no_file_is_larger_than_a_text_has_to_be() {
    let listed = std::process::Command::new("git").args(["ls-files", "-z"]).current_dir(root()).output();
    let Some(listed) = listed.ok().filter(|listed| listed.status.success()) else { return };
    let names = String::from_utf8(listed.stdout).expect("UTF-8");
    let size = |name: &str| std::fs::metadata(root().join(name)).map_or(0, |file| file.len());
    let large: Vec<String> = names
        .split_terminator('\0')
        .filter(|name| size(name) > 512 * 1024 && *name != BACKUP)
        .map(str::to_owned)
        .collect();
    assert_none("larger than 512 KiB", &large);
}

#[test]
fn every_module_opens_with_what_lives_in_it() {
    let mut wrong = Vec::new();
    // A file of unit tests is recognised by its name.
    for path in product().into_iter().filter(|path| !path.ends_with("tests.rs")) {
        let source = read(&path);
        let opening = source.lines().take_while(|line| line.starts_with("//!")).count();
        let most = if path == Path::new(OPENS_WITH_A_MAP) { usize::MAX } else { LONGEST_OPENING };
        if opening == 0 || opening > most {
            wrong.push(format!("{} opens with {opening} lines of //!", path.display()));
        }
    }
    assert_none("an opening has 1 to 6 lines", &wrong);
}

#[test]
fn these_checks_see_through_comments_quotes_and_groups() {
    let source = "use crate::{\n    model::{Address, bytes},\n    ros,\n};\n// crate::cli\n/// [`crate::ui`]\n\
                  let a = \"crate::term \\\" unsafe\"; let b = r#\"crate::app\"#; let c = '\"'; fn f<'a>(x: &'a str) {}\n\
                  crate::chain::Backend; mycrate::no; $crate::store::no; '\\''; unsafe_code";
    let code = code_only(source);
    assert_eq!(crate_names(&code), ["model", "ros", "chain"]);
    assert_eq!(code.lines().count(), source.lines().count());
    assert!(!words(&code).any(|word| word == "unsafe"));
    let source = "use super::{lists::{self, empty}, words as text};\npub(in crate::ui) use windows::Piece;\n\
                  fn f() { super::bars::draw(); }\n#[cfg(test)]\nmod tests { use super::detail; }";
    let (imported, named) = paths_in(source);
    assert_eq!(imported, ["super::lists::self", "super::lists::empty", "super::words", "windows::Piece"]);
    assert_eq!(named, ["super::bars::draw"]);
    assert_eq!(in_full("lists::draw", &imported), "super::lists::draw");
    assert_eq!(in_full("bars::draw", &imported), "bars::draw");
}
