use std::path::Path;

/// Result of the command line's operations.
pub(crate) type Result<T = (), E = Error> = std::result::Result<T, E>;

/// Error of a command.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    #[error(transparent)]
    Core(#[from] cape_core::Error),
    #[error(transparent)]
    Graph(#[from] cape_graph::Error),
    #[error(transparent)]
    Model(#[from] cape_model::Error),
    #[error(transparent)]
    Onnx(#[from] cape_onnx::Error),
    #[error(transparent)]
    Train(#[from] cape_train::Error),
    #[error(transparent)]
    Layer(#[from] cape_layer::Error),
    #[error(transparent)]
    Fit(#[from] cape_fit::Error),
    #[error(transparent)]
    Render(#[from] cape_render::Error),
    /// Error of the command itself, with what was expected.
    #[error("{0}")]
    Message(String),
    /// Error with the operation that failed.
    #[error("{doing}")]
    Context { doing: String, source: Box<Error> },
    /// Standard output was closed, as by `| head`.
    #[error("standard output was closed")]
    OutputClosed,
}

impl Error {
    pub(crate) fn message(message: impl Into<String>) -> Self {
        Self::Message(message.into())
    }

    pub(crate) fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        cape_core::Error::io(path, source).into()
    }

    /// Error in writing to standard output.
    pub(crate) fn output(source: std::io::Error) -> Self {
        match source.kind() {
            std::io::ErrorKind::BrokenPipe => Self::OutputClosed,
            _ => Self::io("standard output", source),
        }
    }
}

/// Adds the operation that failed to an error.
pub(crate) trait Context<T> {
    fn doing(self, doing: impl FnOnce() -> String) -> Result<T>;
}

impl<T, E: Into<Error>> Context<T> for Result<T, E> {
    fn doing(self, doing: impl FnOnce() -> String) -> Result<T> {
        self.map_err(|error| Error::Context { doing: doing(), source: Box::new(error.into()) })
    }
}

/// The error and its causes, one per line. A cause that the line above quotes is left out.
pub(crate) fn report(error: &dyn std::error::Error) -> String {
    format!("error: {}", causes(error).join("\n  caused by: "))
}

/// The error and its causes in one line.
pub(crate) fn in_one_line(error: &dyn std::error::Error) -> String {
    causes(error).join(": ")
}

/// Texts of the error and its causes, without those that the one before quotes.
fn causes(error: &dyn std::error::Error) -> Vec<String> {
    let mut texts = vec![error.to_string()];
    let mut said = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let text = cause.to_string();
        if !said.contains(&text) {
            texts.push(text.clone());
        }
        said = text;
        next = cause.source();
    }
    texts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_listed_once() {
        let inner = Error::io("a.npy", std::io::Error::other("disk on fire"));
        assert_eq!(report(&inner), "error: a.npy: disk on fire");
        let outer = Err::<(), _>(inner).doing(|| "packing".into()).unwrap_err();
        assert_eq!(report(&outer), "error: packing\n  caused by: a.npy: disk on fire");
        assert_eq!(in_one_line(&outer), "packing: a.npy: disk on fire");
    }
}
