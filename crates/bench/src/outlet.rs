//! Where a bench's figures go: text, one JSON document or comma-separated lines on stdout, and a page of plots in a
//! directory if one is given. Benches that run as a set are collected and reported at its end.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;
use serde_json::Value;

use super::report::{Report, csv};
use super::svg::Page;
use authros_model::ErrorKind;
use authros_output::Output;
use authros_service::Failure;
use authros_store::files::atomic_write;

/// The format of the figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// For people.
    Text,
    /// One document.
    Json,
    /// One line per result.
    Csv,
}

/// The output.
#[derive(Debug)]
pub struct Outlet {
    form: Form,
    output: Output,
    plots: Option<PathBuf>,
    gathered: Option<Mutex<Vec<Value>>>,
}

impl Outlet {
    /// Creates the directory for plots if missing, so that nobody measures in vain.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(form: Form, output: Output, plots: Option<PathBuf>) -> Result<Self, Failure> {
        if let Some(directory) = &plots {
            std::fs::create_dir_all(directory).map_err(|error| unwritten(directory, &error))?;
        }
        Ok(Self { form, output, plots, gathered: None })
    }

    /// The same, but documents and lines of single benches are kept for the end of the set.
    pub fn gathering(self) -> Self {
        Self { gathered: Some(Mutex::default()), ..self }
    }

    /// For people, besides the figures.
    pub fn note(&self, text: &str) {
        self.output.note(text);
    }

    /// The channel itself.
    pub fn output(&self) -> Output {
        self.output
    }

    /// Prints a report, and draws its page.
    ///
    /// # Errors
    /// If the page cannot be written.
    pub fn show<R: Serialize>(
        &self,
        report: &Report<R>,
        text: impl FnOnce() -> String,
        page: impl FnOnce() -> Page,
    ) -> Result<(), Failure> {
        if let Some(directory) = &self.plots {
            let path = directory.join(format!("{}.svg", report.name));
            atomic_write(&path, page().draw().as_bytes())?;
        }
        let value = || serde_json::to_value(report).unwrap_or_default();
        match (&self.gathered, self.form) {
            (_, Form::Text) => self.output.result(&(), text),
            (Some(gathered), _) => gathered.lock().unwrap_or_else(PoisonError::into_inner).push(value()),
            (None, Form::Json) => self.output.result(report, String::new),
            (None, Form::Csv) => self.tell(&value(), String::new),
        }
        Ok(())
    }

    /// Prints a document with `results`.
    pub fn tell(&self, document: &Value, text: impl FnOnce() -> String) {
        let results = document.get("results").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        match self.form {
            Form::Csv => Output::new(false).result(&(), || csv(results)),
            Form::Json | Form::Text => self.output.result(document, text),
        }
    }

    /// The documents of the set so far.
    pub fn gathered(&self) -> Vec<Value> {
        self.gathered.as_ref().map_or(Vec::new(), |all| all.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }
}

fn unwritten(directory: &Path, error: &std::io::Error) -> Failure {
    let text = format!("the directory {} cannot be created: {error}; choose another with --svg", directory.display());
    Failure::new(ErrorKind::Home, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_directory_that_cannot_be_made_is_told_before_anything_is_measured() {
        let directory = tempfile::tempdir().expect("a directory");
        let file = directory.path().join("file");
        std::fs::write(&file, b"x").expect("written");
        let failed = Outlet::open(Form::Text, Output::new(false), Some(file.join("plots"))).expect_err("no directory");
        assert!(failed.kind == ErrorKind::Home && failed.message.contains("--svg"), "{failed:?}");
    }
}
