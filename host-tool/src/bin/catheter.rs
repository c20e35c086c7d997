//! The `catheter` command.
fn main() -> std::process::ExitCode {
    host_tool::cli::main()
}
