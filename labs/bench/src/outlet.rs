//! Where a bench's figures go: a table on stdout, and CSV, JSON and SVG files in a folder.

use std::path::PathBuf;

use serde::Serialize;

use super::plot::Page;
use super::report::{Report, csv};
use authros_model::ErrorKind;
use authros_output::Output;
use authros_service::Failure;
use authros_service::reply::internal;
use authros_store::files::atomic_write;

/// The output.
#[derive(Debug)]
pub struct Outlet {
    folder: PathBuf,
    output: Output,
}

impl Outlet {
    /// Creates the folder if it is missing, before anything is measured.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn open(folder: PathBuf, output: Output) -> Result<Self, Failure> {
        std::fs::create_dir_all(&folder).map_err(|error| {
            let text = format!("the folder {} cannot be created: {error}; choose another with --out", folder.display());
            Failure::new(ErrorKind::Home, text)
        })?;
        Ok(Self { folder, output })
    }

    /// A line on stderr.
    pub fn note(&self, text: &str) {
        self.output.note(text);
    }

    /// A table on stdout.
    pub fn tell(&self, text: &str) {
        self.output.result(&(), || text.to_owned());
    }

    /// Writes the report's three files, and its tables to stdout.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn show<R: Serialize>(&self, report: &Report<R>, tables: &[String], page: &Page) -> Result<(), Failure> {
        let document = serde_json::to_value(report).map_err(|error| internal(error.to_string()))?;
        let rows = document.get("results").and_then(|rows| rows.as_array()).cloned().unwrap_or_default();
        let json = serde_json::to_string_pretty(&document).map_err(|error| internal(error.to_string()))?;
        for (kind, text) in [("csv", csv(&rows)), ("json", json), ("svg", page.draw()?)] {
            atomic_write(&self.folder.join(format!("{}.{kind}", report.name)), text.as_bytes())?;
        }
        self.tell(&report.text(tables));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_made_is_refused_before_anything_is_measured() {
        let directory = tempfile::tempdir().expect("a directory");
        let file = directory.path().join("file");
        std::fs::write(&file, b"x").expect("written");
        let failed = Outlet::open(file.join("results"), Output::new(false)).expect_err("no folder");
        assert!(failed.kind == ErrorKind::Home && failed.message.contains("--out"), "{failed:?}");
    }
}
