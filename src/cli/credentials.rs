//! What a client shows a server to be let in, and how it knows the server.

use std::path::PathBuf;

use reqwest::header::HeaderValue;

use union3d::wire::trust::Trust;

/// The variable that holds the key where there is no file.
const VARIABLE: &str = "UNION3D_KEY";

/// What to do about a server that does not know who asks.
pub(crate) const ADVICE: &str = " (--key-file or UNION3D_KEY says the key)";

/// How to be let in.
#[derive(Clone, Debug, Default, clap::Args)]
pub(crate) struct CredentialsArgs {
    /// File with the key for the server, where that has keys [default: the variable `UNION3D_KEY`, if it is set]. The key is not taken
    /// as an argument, which everybody on this machine could read.
    #[arg(long, value_name = "FILE")]
    pub(crate) key_file: Option<PathBuf>,
    /// File of certificates (PEM) to trust besides the machine's authorities: of a server with `https://`, or of who signed its own.
    #[arg(long, value_name = "FILE")]
    pub(crate) ca: Option<PathBuf>,
}

/// What is shown with every request.
#[derive(Clone, Debug, Default)]
pub(crate) struct Credentials {
    /// The value of `Authorization`, marked as secret.
    pub(crate) authorization: Option<HeaderValue>,
    /// Who is believed to be the server.
    pub(crate) trust: Trust,
}

impl CredentialsArgs {
    /// Reads the key and the certificates.
    pub(crate) fn read(&self) -> Result<Credentials, String> {
        let trust = self.ca.as_deref().map(Trust::read).transpose();
        let trust = trust.map_err(|error| format!("--ca {error}"))?;
        Ok(Credentials {
            authorization: self.authorization()?,
            trust: trust.unwrap_or_default(),
        })
    }

    fn authorization(&self) -> Result<Option<HeaderValue>, String> {
        let (text, from) = match &self.key_file {
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .map_err(|error| format!("--key-file {}: {error}", path.display()))?;
                (text, format!("--key-file {}", path.display()))
            }
            None => match std::env::var(VARIABLE) {
                Ok(text) if !text.trim().is_empty() => (text, VARIABLE.to_owned()),
                _ => return Ok(None),
            },
        };
        let key = text.trim();
        let is_key = !key.is_empty() && key.bytes().all(|byte| byte.is_ascii_graphic());
        let value = HeaderValue::try_from(format!("Bearer {key}"));
        let mut value = value
            .ok()
            .filter(|_| is_key)
            // What stands there is not shown: most of it may be a key.
            .ok_or_else(|| format!("{from}: there is no single key"))?;
        value.set_sensitive(true);
        Ok(Some(value))
    }
}
