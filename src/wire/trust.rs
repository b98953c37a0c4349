//! Which servers a client believes to be who they say: those whose certificates come from the machine's authorities, or those of a file.

use std::path::Path;
use std::sync::Arc;

use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use tonic::transport::ClientTlsConfig;

/// Certificates that are trusted besides the machine's.
#[derive(Clone, Debug, Default)]
pub struct Trust {
    besides: Vec<CertificateDer<'static>>,
}

impl Trust {
    /// Those of a file in PEM.
    /// # Errors
    /// It cannot be read, or there is none in it: in words, with the path.
    pub fn read(path: &Path) -> Result<Self, String> {
        let wrong = |cause: String| format!("{}: {cause}", path.display());
        let text = std::fs::read(path).map_err(|error| wrong(error.to_string()))?;
        let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
        let besides = found.map_err(|error| wrong(error.to_string()))?;
        if besides.is_empty() {
            return Err(wrong("there is no certificate in it".to_owned()));
        }
        let mut roots = RootCertStore::empty();
        for certificate in &besides {
            let added = roots.add(certificate.clone());
            added.map_err(|error| wrong(format!("a certificate cannot be taken: {error}")))?;
        }
        Ok(Self { besides })
    }

    fn roots(&self) -> RootCertStore {
        let mut roots = RootCertStore::empty();
        // A machine may have none, or some that cannot be read: then a server that has its certificate from them is not believed.
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        roots.add_parsable_certificates(self.besides.iter().cloned());
        roots
    }

    /// What a client of HTTP is made with. `is_used`: whether its server speaks TLS at all.
    pub fn http(&self, is_used: bool) -> ClientConfig {
        let roots = if is_used {
            self.roots()
        } else {
            RootCertStore::empty()
        };
        ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .expect("the provider has the suites of every version")
            .with_root_certificates(roots)
            .with_no_client_auth()
    }

    /// What a client of gRPC is made with.
    pub fn grpc(&self) -> ClientTlsConfig {
        ClientTlsConfig::new().trust_anchors(self.roots().roots)
    }
}

/// Makes the cryptography of this program that of the process, for clients that are made without: a `reqwest::Client` of its own needs it.
pub fn install_provider() {
    // One that is there already stays.
    drop(ring::default_provider().install_default());
}
