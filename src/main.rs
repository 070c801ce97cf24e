//! The binary: everything is in the library, see `authros::cli`.

fn main() -> std::process::ExitCode {
    authros::cli::main()
}
