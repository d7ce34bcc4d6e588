//! Exit code of the program.

/// Exit code of a command; unlike the standard library's, its number can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ExitCode(u8);

impl ExitCode {
    /// The command did what it was asked to.
    pub(crate) const SUCCESS: Self = Self(0);
    /// The command failed, or found its input unsound.
    pub(crate) const FAILURE: Self = Self(1);
    /// The command was interrupted and can be resumed.
    pub(crate) const INTERRUPTED: Self = Self(130);

    /// The number that the operating system gets.
    pub(crate) fn number(self) -> u8 {
        self.0
    }
}
