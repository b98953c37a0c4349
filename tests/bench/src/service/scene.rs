//! A scene of the server, by the calls that do not count: made, compared, dropped.

use std::net::SocketAddr;

use bytes::Bytes;
use hyper::Method;
use serde_json::Value;

use super::bodies::Kind;
use super::link::Link;
use crate::failure::Failure;

/// Where its changes are posted.
pub(super) fn changes(scene: &str) -> String {
    format!("/v1/scenes/{scene}/changes?return=minimal")
}

/// Makes a scene.
pub(super) async fn create(
    server: SocketAddr,
    scene: &str,
    settings: Bytes,
) -> Result<(), Failure> {
    let path = format!("/v1/scenes/{scene}");
    let mut link = Link::open(server).await?;
    let kind = Some("application/json");
    link.expect(Method::PUT, &path, kind, settings).await?;
    Ok(())
}

/// Checks that a scene has as many bodies as were acknowledged, and drops it.
pub(super) async fn check_and_drop(
    server: SocketAddr,
    scene: &str,
    kind: Kind,
    bodies: usize,
) -> Result<(), Failure> {
    let mut link = Link::open(server).await?;
    let name = kind.plural();
    let found = mass_properties(&mut link, scene).await?[name].as_u64();
    if found != Some(bodies as u64) {
        return Err(format!("{bodies} {name} were acknowledged, and {found:?} are there").into());
    }
    let path = format!("/v1/scenes/{scene}");
    link.expect(Method::DELETE, &path, None, Bytes::new())
        .await?;
    Ok(())
}

/// Its totals now.
pub(super) async fn mass_properties(link: &mut Link, scene: &str) -> Result<Value, Failure> {
    let path = format!("/v1/scenes/{scene}/mass-properties");
    let text = link.expect(Method::GET, &path, None, Bytes::new()).await?;
    Ok(serde_json::from_slice(&text)?)
}
