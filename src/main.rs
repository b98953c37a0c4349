//! The command line of union3d.

mod cli;

/// Solids are prepared in many small pieces, by several threads at once: with the C library's allocator that takes a fifth longer.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::main()
}
