//! The faulty twin of the binary: the same program, built with the feature `fault`, in which the environment variable
//! `AUTHROS_FAULT` switches off one check. For tests; never released.

fn main() -> std::process::ExitCode {
    authros::cli::main()
}
