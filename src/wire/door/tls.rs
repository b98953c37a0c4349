//! Encryption by rustls: certificate and key from files, read again when they are renewed.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use arc_swap::ArcSwap;
use parking_lot::Mutex;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig};
use tokio_rustls::server::TlsStream;

/// Where certificates are, all as PEM.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CertificateFiles {
    /// The server's certificate, followed by those that lead to its authority.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// The authorities of which every client must have a certificate; none when clients need none.
    pub client_ca: Option<PathBuf>,
}

/// Why certificates cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum InvalidCertificate {
    /// A file cannot be read.
    #[error("cannot read {path}: {cause}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// A file does not hold what it should.
    #[error("{path} holds no {what} in PEM{cause}", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What it should hold.
        what: &'static str,
        /// What is there instead, if that is known.
        cause: String,
    },
    /// They do not go together.
    #[error("{certificate} and {key} cannot be used together: {cause}", certificate = certificate.display(), key = key.display())]
    Unusable {
        /// The file of the certificate.
        certificate: PathBuf,
        /// The file of the key.
        key: PathBuf,
        /// Why.
        cause: String,
    },
}

/// What is in the files.
#[derive(Clone, PartialEq, Eq)]
struct Contents {
    certificate: Vec<u8>,
    key: Vec<u8>,
    client_ca: Option<Vec<u8>>,
}

/// The certificates in use.
pub struct Tls {
    files: CertificateFiles,
    current: ArcSwap<ServerConfig>,
    /// What the files held when they were looked at last, whether or not that could be used.
    seen: Mutex<Option<Contents>>,
}

impl Tls {
    /// Reads the files.
    /// # Errors
    /// What is wrong with which of them.
    pub fn load(files: CertificateFiles) -> Result<Self, InvalidCertificate> {
        let contents = Contents::read(&files)?;
        let config = contents.config(&files)?;
        Ok(Self {
            files,
            current: ArcSwap::from_pointee(config),
            seen: Mutex::new(Some(contents)),
        })
    }

    /// Reads the files again. Whether there is something new in them, which holds from the next connection on.
    /// # Errors
    /// What is new cannot be used; what was in use before still is. Told once, until they change again.
    pub fn renew(&self) -> Result<bool, InvalidCertificate> {
        let mut seen = self.seen.lock();
        let contents = match Contents::read(&self.files) {
            Ok(contents) => contents,
            // It is said once, and whatever is there next is new.
            Err(error) => return seen.take().map_or(Ok(false), |_| Err(error)),
        };
        if seen.as_ref() == Some(&contents) {
            return Ok(false);
        }
        let config = contents.config(&self.files);
        *seen = Some(contents);
        self.current.store(Arc::new(config?));
        Ok(true)
    }

    /// Looks at the files again and again, and says in the log what came of it.
    pub async fn keep_renewed(self: Arc<Self>, pause: Duration) {
        loop {
            tokio::time::sleep(pause).await;
            let this = self.clone();
            // Files may be on a disk that takes its time.
            match tokio::task::spawn_blocking(move || this.renew()).await {
                Ok(Ok(true)) => tracing::info!("the TLS certificate was renewed"),
                Ok(Ok(false)) => {}
                Ok(Err(error)) => {
                    tracing::error!(
                        "the renewed TLS certificate is not used, but the one before: {error}"
                    );
                }
                Err(failed) => tracing::error!("the TLS certificate was not looked at: {failed}"),
            }
        }
    }

    /// Begins an encrypted connection.
    pub(super) async fn accept(&self, stream: TcpStream) -> std::io::Result<TlsStream<TcpStream>> {
        TlsAcceptor::from(self.current.load_full())
            .accept(stream)
            .await
    }
}

impl Contents {
    fn read(files: &CertificateFiles) -> Result<Self, InvalidCertificate> {
        let read = |path: &PathBuf| {
            std::fs::read(path).map_err(|cause| InvalidCertificate::Unreadable {
                path: path.clone(),
                cause,
            })
        };
        Ok(Self {
            certificate: read(&files.certificate)?,
            key: read(&files.key)?,
            client_ca: files.client_ca.as_ref().map(read).transpose()?,
        })
    }

    fn config(&self, files: &CertificateFiles) -> Result<ServerConfig, InvalidCertificate> {
        let unusable = |cause: String| InvalidCertificate::Unusable {
            certificate: files.certificate.clone(),
            key: files.key.clone(),
            cause,
        };
        let provider = Arc::new(default_provider());
        let builder = ServerConfig::builder_with_provider(provider.clone())
            .with_safe_default_protocol_versions()
            .map_err(|error| unusable(error.to_string()))?;
        let builder = match (&self.client_ca, &files.client_ca) {
            (Some(pem), Some(path)) => {
                let malformed = |cause: String| malformed(path, "certificate", &cause);
                let mut roots = RootCertStore::empty();
                for authority in certificates(path, pem)? {
                    roots
                        .add(authority)
                        .map_err(|error| malformed(error.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(roots.into(), provider);
                let verifier = verifier
                    .build()
                    .map_err(|error| malformed(error.to_string()))?;
                builder.with_client_cert_verifier(verifier)
            }
            _ => builder.with_no_client_auth(),
        };
        let chain = certificates(&files.certificate, &self.certificate)?;
        let key = PrivateKeyDer::from_pem_slice(&self.key);
        let key = key.map_err(|error| malformed(&files.key, "private key", &error.to_string()))?;
        let config = builder.with_single_cert(chain, key);
        let mut config = config.map_err(|error| unusable(error.to_string()))?;
        config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        Ok(config)
    }
}

/// The certificates of a file, at least one.
fn certificates(
    path: &Path,
    pem: &[u8],
) -> Result<Vec<CertificateDer<'static>>, InvalidCertificate> {
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem).collect();
    match found {
        Ok(found) if found.is_empty() => Err(malformed(path, "certificate", "")),
        Ok(found) => Ok(found),
        Err(error) => Err(malformed(path, "certificate", &error.to_string())),
    }
}

fn malformed(path: &Path, what: &'static str, cause: &str) -> InvalidCertificate {
    let separator = if cause.is_empty() { "" } else { ": " };
    InvalidCertificate::Malformed {
        path: path.to_owned(),
        what,
        cause: format!("{separator}{cause}"),
    }
}
