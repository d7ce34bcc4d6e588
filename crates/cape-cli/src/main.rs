//! The `cape` command.

fn main() -> std::process::ExitCode {
    cape_cli::main()
}
