//! The command line `gatherlight`.

fn main() -> std::process::ExitCode {
    gatherlight::cli::main()
}
