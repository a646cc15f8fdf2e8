//! What can go wrong inside the core.

/// A failure with the stable code that the Python layer hands on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Error {
    /// The progress callback asked to stop.
    Cancelled,
    /// The heights cannot be triangulated.
    Input { code: &'static str, message: String },
    /// An option is out of bounds.
    Option { code: &'static str, message: String },
}

impl Error {
    pub(crate) fn input(code: &'static str, message: impl Into<String>) -> Self {
        Error::Input { code, message: message.into() }
    }

    pub(crate) fn option(code: &'static str, message: impl Into<String>) -> Self {
        Error::Option { code, message: message.into() }
    }
}

pub type Result<T> = std::result::Result<T, Error>;
