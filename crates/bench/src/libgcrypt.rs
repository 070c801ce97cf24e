//! libgcrypt as a yardstick: a small C program, built here with the system's compiler, that does a piece of work on
//! request. Its runs and ours thus take turns and share the load on the machine.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use authros_model::clean;

const SOURCE: &str = include_str!("../../../benches/libgcrypt.c");
/// What to do if it cannot be built.
const ADVICE: &str = "for its figures install a C compiler and libgcrypt's headers (Debian: gcc, libgcrypt20-dev)";

/// The running program.
#[derive(Debug)]
pub struct Libgcrypt {
    child: Child,
    questions: ChildStdin,
    answers: BufReader<ChildStdout>,
    /// Its name and version.
    pub version: String,
    _directory: tempfile::TempDir,
}

impl Libgcrypt {
    /// Builds and starts it, or says why it cannot.
    pub fn start() -> Result<Self, String> {
        Self::built().map_err(|why| format!("libgcrypt was not timed: {}; {ADVICE}", clean(&why, 300)))
    }

    fn built() -> Result<Self, String> {
        let text = |error: std::io::Error| error.to_string();
        let directory = tempfile::tempdir().map_err(text)?;
        let program = build(directory.path())?;
        let mut child = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(text)?;
        let (Some(questions), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err("its program has no pipes".to_owned());
        };
        let mut answers = BufReader::new(answers);
        let version = answer(&mut answers)?;
        Ok(Self { child, questions, answers, version, _directory: directory })
    }

    /// How long it took for `work` (sm3, seal or open) on this many bytes, microseconds.
    pub fn time(&mut self, work: &str, bytes: usize) -> Result<f64, String> {
        writeln!(self.questions, "{work} {bytes}").map_err(|error| error.to_string())?;
        let nanoseconds = answer(&mut self.answers)?;
        nanoseconds.parse::<f64>().map(|nanoseconds| nanoseconds / 1e3).map_err(|error| error.to_string())
    }
}

impl Drop for Libgcrypt {
    fn drop(&mut self) {
        // It ends with its input anyway; this only reaps it.
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

fn build(directory: &Path) -> Result<std::path::PathBuf, String> {
    let (source, program) = (directory.join("libgcrypt.c"), directory.join("libgcrypt"));
    std::fs::write(&source, SOURCE).map_err(|error| error.to_string())?;
    let compiler = std::env::var_os("CC").filter(|name| !name.is_empty()).unwrap_or_else(|| "cc".into());
    let built = Command::new(compiler).arg("-O2").arg(&source).arg("-o").arg(&program).arg("-lgcrypt").output();
    let built = built.map_err(|error| format!("the C compiler cannot be run ({error})"))?;
    if built.status.success() {
        return Ok(program);
    }
    let words = String::from_utf8_lossy(&built.stderr);
    Err(format!("the C compiler refused ({})", words.lines().next().unwrap_or("no reason given")))
}
