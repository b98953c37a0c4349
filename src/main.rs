//! The command line of union3d.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
