//! Other libraries as yardsticks, libgcrypt and OpenSSL: a small C program for each, built here with the system's
//! compiler, that does a piece of work on command. Its runs and ours take turns, so they share the effects of other
//! load on the machine.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use authros_model::clean;

/// A library measured beside ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Library {
    /// Its name in the figures.
    pub name: &'static str,
    /// The program.
    source: &'static str,
    /// The libraries to link.
    link: &'static str,
    /// What to do if it cannot be built.
    advice: &'static str,
}

/// From the GNU project: SM3 and SM4.
pub const LIBGCRYPT: Library = Library {
    name: "libgcrypt",
    source: include_str!("../../../benches/libgcrypt.c"),
    link: "-lgcrypt",
    advice: "to include it, install a C compiler and libgcrypt's headers (Debian: gcc, libgcrypt20-dev)",
};

/// OpenSSL 3: SM2. The program declares what it calls, so the shared library alone is enough.
pub const OPENSSL: Library = Library {
    name: "openssl",
    source: include_str!("../../../benches/openssl.c"),
    link: "-l:libcrypto.so.3",
    advice: "to include it, install a C compiler and OpenSSL 3 (Debian: gcc, libssl3)",
};

/// The running program.
#[derive(Debug)]
pub struct Yardstick {
    child: Child,
    questions: ChildStdin,
    answers: BufReader<ChildStdout>,
    /// Its name and version.
    pub version: String,
    _directory: tempfile::TempDir,
}

impl Yardstick {
    /// Builds and starts it, or says why that is impossible.
    pub fn start(library: Library) -> Result<Self, String> {
        let Library { name, advice, .. } = library;
        Self::built(library).map_err(|why| format!("{name} was not timed: {}; {advice}", clean(&why, 300)))
    }

    fn built(library: Library) -> Result<Self, String> {
        let text = |error: std::io::Error| error.to_string();
        let directory = tempfile::tempdir().map_err(text)?;
        let program = build(library, directory.path())?;
        let mut child = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(text)?;
        let (Some(questions), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err("its program has no pipes".to_owned());
        };
        let mut answers = BufReader::new(answers);
        let version = answer(&mut answers)?;
        Ok(Self { child, questions, answers, version, _directory: directory })
    }

    /// How long it took for a piece of work on this many bytes, microseconds.
    pub fn time(&mut self, work: &str, bytes: usize) -> Result<f64, String> {
        writeln!(self.questions, "{work} {bytes}").map_err(|error| error.to_string())?;
        let nanoseconds = answer(&mut self.answers)?;
        nanoseconds.parse::<f64>().map(|nanoseconds| nanoseconds / 1e3).map_err(|error| error.to_string())
    }
}

impl Drop for Yardstick {
    fn drop(&mut self) {
        // It ends with its input anyway; this only collects it.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

fn answer(answers: &mut BufReader<ChildStdout>) -> Result<String, String> {
    let mut line = String::new();
    match answers.read_line(&mut line) {
        Ok(0) => Err("its program ended".to_owned()),
        Ok(_) => Ok(clean(line.trim(), 60)),
        Err(error) => Err(error.to_string()),
    }
}

fn build(library: Library, directory: &Path) -> Result<std::path::PathBuf, String> {
    let (source, program) = (directory.join("yardstick.c"), directory.join("yardstick"));
    std::fs::write(&source, library.source).map_err(|error| error.to_string())?;
    let compiler = std::env::var_os("CC").filter(|name| !name.is_empty()).unwrap_or_else(|| "cc".into());
    let built = Command::new(compiler).arg("-O2").arg(&source).arg("-o").arg(&program).arg(library.link).output();
    let built = built.map_err(|error| format!("the C compiler cannot be run ({error})"))?;
    if built.status.success() {
        return Ok(program);
    }
    let words = String::from_utf8_lossy(&built.stderr);
    Err(format!("the C compiler refused ({})", words.lines().next().unwrap_or("no reason given")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_library_that_is_not_there_is_told_with_what_to_do() {
        let absent = Library { name: "nowhere", source: "int main(void) { return 0; }", link: "-lnowhere", ..OPENSSL };
        let told = Yardstick::start(absent).expect_err("no such library");
        assert!(told.starts_with("nowhere was not timed: ") && told.contains("install a C compiler"), "{told}");
        let silent = Library { source: "int main(void) { return 0; }", link: "-lc", ..OPENSSL };
        let told = Yardstick::start(silent).expect_err("says nothing");
        assert!(told.starts_with("openssl was not timed: "), "{told}");
    }
}
