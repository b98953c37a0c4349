//! Encrypted connections, of both protocols; certificates that are renewed; clients that must have one.

use std::sync::Arc;

use bytes::Bytes;
use tokio::io::AsyncWriteExt;
use union3d::wire::door::{CertificateFiles, Settings, Tls};

use crate::certificates::Authority;
use crate::server::{Server, Setup, call, get, http2, rest, status, until};

const HEALTH: &str = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";

async fn start(files: CertificateFiles) -> (Server, Arc<Tls>) {
    let tls = Arc::new(Tls::load(files).unwrap());
    let setup = Setup {
        tls: Some(tls.clone()),
        ..Setup::default()
    };
    (Server::start(setup).await, tls)
}

#[tokio::test]
async fn both_apis_are_encrypted() {
    let authority = Authority::new();
    let (server, _) = start(authority.files()).await;
    let mut stream = authority
        .connect(&server.http, b"http/1.1", None)
        .await
        .unwrap();
    stream.write_all(HEALTH.as_bytes()).await.unwrap();
    assert!(until(&mut stream, "ok").await.starts_with("HTTP/1.1 200"));
    let stream = authority.connect(&server.http, b"h2", None).await.unwrap();
    let (requests, _) = http2(stream).await;
    let (code, text) = get(&requests, "/healthz").await;
    assert_eq!((code, text.contains("ok")), (200, true));
    let stream = authority.connect(&server.grpc, b"h2", None).await.unwrap();
    let (requests, _) = http2(stream).await;
    let call = call(&server.grpc, "/grpc.health.v1.Health/Check");
    let mut requests = requests.ready().await.unwrap();
    let (answer, mut body) = requests.send_request(call, false).unwrap();
    body.send_data(Bytes::from_static(&[0; 5]), true).unwrap();
    assert_eq!(status(answer.await.unwrap()).await, "0");
    // Who does not encrypt is not answered, and nobody waits for him.
    let answer = server.ask(HEALTH).await;
    assert!(!answer.contains("HTTP"), "{answer}");
}

#[tokio::test]
async fn a_renewed_certificate_holds_from_the_next_connection_on() {
    let authority = Authority::new();
    let (server, tls) = start(authority.files()).await;
    let shown = async || {
        let stream = authority
            .connect(&server.http, b"http/1.1", None)
            .await
            .unwrap();
        let certificates = stream.get_ref().1.peer_certificates().unwrap().to_vec();
        (stream, certificates)
    };
    let (mut old_stream, old) = shown().await;
    assert!(!tls.renew().unwrap(), "nothing is new");
    let pair = authority.sign();
    authority.write(&pair);
    assert!(tls.renew().unwrap());
    let (_, new) = shown().await;
    assert_ne!(new, old);
    // What was there before goes on.
    old_stream.write_all(HEALTH.as_bytes()).await.unwrap();
    assert!(until(&mut old_stream, "ok").await.contains("200 OK"));
    // A certificate whose key has not come yet is told once, and the one before stays in use.
    let other = authority.sign();
    let certificate = authority.path().join("server.pem");
    std::fs::write(&certificate, &other.certificate).unwrap();
    let told = tls.renew().unwrap_err().to_string();
    assert!(
        told.contains("server.pem") && told.contains("server.key"),
        "{told}"
    );
    assert!(!tls.renew().unwrap(), "it is told once");
    assert_eq!(shown().await.1, new);
    std::fs::remove_file(&certificate).unwrap();
    let told = tls.renew().unwrap_err().to_string();
    assert!(told.contains("server.pem"), "{told}");
    assert!(!tls.renew().unwrap(), "it is told once");
    assert_eq!(shown().await.1, new);
    authority.write(&other);
    assert!(tls.renew().unwrap());
    assert_ne!(shown().await.1, new);
}

#[tokio::test]
async fn clients_must_have_certificates_when_that_is_set() {
    let (authority, strangers) = (Authority::new(), Authority::new());
    let files = CertificateFiles {
        client_ca: Some(authority.path().join("ca.pem")),
        ..authority.files()
    };
    let (server, _) = start(files).await;
    let own = authority.sign();
    for address in [&server.http, &server.grpc] {
        let stream = authority.connect(address, b"h2", Some(&own)).await;
        let (requests, _) = http2(stream.unwrap()).await;
        assert!(get(&requests, "/healthz").await.0 == 200 || *address == server.grpc);
        for own in [None, Some(strangers.sign())] {
            // With TLS 1.3 the client believes itself connected until it reads.
            let refused = match authority.connect(address, b"http/1.1", own.as_ref()).await {
                Err(_) => true,
                Ok(mut stream) => {
                    let _ = stream.write_all(HEALTH.as_bytes()).await;
                    !rest(&mut stream).await.contains("HTTP")
                }
            };
            assert!(refused);
        }
    }
}

#[tokio::test]
async fn files_that_cannot_be_used_are_named() {
    let authority = Authority::new();
    let files = authority.files();
    let refused = |files: CertificateFiles| Tls::load(files).err().unwrap().to_string();
    let missing = CertificateFiles {
        key: authority.path().join("missing.key"),
        ..files.clone()
    };
    assert!(refused(missing).contains("missing.key"));
    let swapped = CertificateFiles {
        certificate: files.key.clone(),
        ..files.clone()
    };
    let told = refused(swapped);
    assert!(
        told.contains("server.key") && told.contains("certificate"),
        "{told}"
    );
    let swapped = CertificateFiles {
        key: files.certificate.clone(),
        ..files.clone()
    };
    let told = refused(swapped);
    assert!(
        told.contains("server.pem") && told.contains("private key"),
        "{told}"
    );
    let strange = CertificateFiles {
        client_ca: Some(files.key.clone()),
        ..files
    };
    assert!(refused(strange).contains("server.key"));
}

#[tokio::test]
async fn a_handshake_that_does_not_come_to_its_end_is_not_waited_for() {
    let authority = Authority::new();
    let tls = Arc::new(Tls::load(authority.files()).unwrap());
    let door = Settings {
        handshake_timeout: std::time::Duration::from_millis(50),
        ..Settings::default()
    };
    let server = Server::start(Setup {
        door,
        tls: Some(tls),
        ..Setup::default()
    });
    let server = server.await;
    let mut stream = server.connect().await;
    // The beginning of a handshake, without its rest.
    stream.write_all(&[0x16, 3, 1, 2, 0, 1]).await.unwrap();
    assert_eq!(rest(&mut stream).await, "");
}
