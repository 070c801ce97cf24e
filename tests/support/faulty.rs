//! The faulty twin of the binary: the same program, in which the environment variables of `authros-fault` cause faults.

fn main() -> std::process::ExitCode {
    authros_fault::arm();
    authros::cli::main()
}
