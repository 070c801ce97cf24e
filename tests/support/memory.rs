//! What a process holds, and what only the site may know.

use std::fs;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use authros_crypto::{Keyring, Passphrase};

use super::authros::files_below;

/// The readable memory of a process; `None` if this user may not read it.
pub fn memory_of(process: &str) -> Option<Vec<u8>> {
    let folder = Path::new("/proc").join(process);
    let maps = fs::read_to_string(folder.join("maps")).ok()?;
    let mut file = fs::File::open(folder.join("mem")).ok()?;
    let mut memory = Vec::new();
    for line in maps.lines() {
        let mut words = line.split_whitespace();
        let (Some(range), Some(rights)) = (words.next(), words.next()) else { continue };
        let ends = range.split_once('-').map(|(from, to)| (u64::from_str_radix(from, 16), u64::from_str_radix(to, 16)));
        let Some((Ok(from), Ok(to))) = ends else { continue };
        // What is only executed is the program itself.
        if !rights.starts_with("rw") || line.ends_with("[vvar]") || file.seek(SeekFrom::Start(from)).is_err() {
            continue;
        }
        // A mapping may be gone by now.
        drop(file.by_ref().take(to - from).read_to_end(&mut memory));
    }
    Some(memory)
}

/// Every secret of every profile below a folder: its passphrase, its keys, and those of its epochs; with names.
pub fn secrets_below(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for path in files_below(folder).into_iter().filter(|path| path.ends_with("keyring")) {
        let text = fs::read_to_string(path.with_file_name("passphrase")).expect("the passphrase beside it");
        let text = text.lines().next().expect("a line").to_owned();
        let passphrase = Passphrase::new(text.clone()).expect("a passphrase");
        let keys = Keyring::load(&path, &passphrase).expect("it opens");
        let mut add = |name: &str, bytes: &[u8]| found.push((format!("{name} of {}", path.display()), bytes.to_vec()));
        add("passphrase", text.as_bytes());
        add("Ethereum key", keys.eoa.expose());
        add("signing key", keys.signing.secret.expose());
        add("envelope key", keys.envelope.secret.expose());
        add("SM4 key", keys.sm4.expose());
        add("index key", keys.index.expose());
        for network in keys.networks.values() {
            for epoch in network.epochs.values() {
                add("epoch key", epoch.key.expose());
            }
        }
    }
    found
}

/// The names of those that are somewhere in `memory`.
pub fn found_in<'a>(memory: &[u8], secrets: &'a [(String, Vec<u8>)]) -> Vec<&'a str> {
    let mut firsts = [false; 256];
    secrets.iter().for_each(|(_, secret)| firsts[usize::from(secret[0])] = true);
    let mut found: Vec<&str> = Vec::new();
    for (place, byte) in memory.iter().enumerate().filter(|(_, byte)| firsts[usize::from(**byte)]) {
        let is_here = |secret: &[u8]| secret[0] == *byte && memory[place..].starts_with(secret);
        found.extend(secrets.iter().filter(|(_, secret)| is_here(secret)).map(|(name, _)| name.as_str()));
    }
    found
}
