//! The command `catoptra`: the five scenes played, rendered, measured and compared.

fn main() -> std::process::ExitCode {
    catoptra_demos::cli::main()
}
