//! Meshes: what is in them, in each format, and what is refused.

use std::collections::BTreeMap;

use reqwest::Response;
use serde_json::json;

use crate::random::Random;
use crate::server::Server;

/// A triangle's corners.
type Triangle = [[f64; 3]; 3];

async fn mesh(server: &Server, scene: &str, query: &str) -> Response {
    let path = format!("{scene}/mesh?{query}");
    let response = server.request("GET", &path).send().await.unwrap();
    assert_eq!(response.status(), 200, "{path}");
    response
}

async fn bytes(server: &Server, scene: &str, query: &str) -> Vec<u8> {
    let bytes = mesh(server, scene, query).await.bytes().await.unwrap();
    bytes.to_vec()
}

/// The numbers of 32 bits at a place of a file.
fn number(file: &[u8], at: usize) -> [u8; 4] {
    file[at..at + 4].try_into().unwrap()
}

fn stl(file: &[u8]) -> Vec<Triangle> {
    let count = usize::try_from(u32::from_le_bytes(number(file, 80))).unwrap();
    assert_eq!(file.len(), 84 + 50 * count);
    (0..count)
        .map(|triangle| {
            [0, 1, 2].map(|corner| {
                [0, 1, 2].map(|axis| {
                    let at = 84 + 50 * triangle + 12 + 12 * corner + 4 * axis;
                    f64::from(f32::from_le_bytes(number(file, at)))
                })
            })
        })
        .collect()
}

fn volume(triangles: &[Triangle]) -> f64 {
    let of = |[a, b, c]: &Triangle| {
        let cross = [0, 1, 2].map(|axis| {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            b[next] * c[last] - b[last] * c[next]
        });
        a[0] * cross[0] + a[1] * cross[1] + a[2] * cross[2]
    };
    triangles.iter().map(of).sum::<f64>() / 6.0
}

#[track_caller]
fn check_closed(triangles: &[Triangle]) {
    let mut balance: BTreeMap<[[u64; 3]; 2], i32> = BTreeMap::new();
    for triangle in triangles {
        let corners = triangle.map(|corner| corner.map(|at| (at + 0.0).to_bits()));
        for (tail, head) in [(0, 1), (1, 2), (2, 0)] {
            let (tail, head) = (corners[tail], corners[head]);
            *balance.entry([tail.min(head), tail.max(head)]).or_default() +=
                if tail < head { 1 } else { -1 };
        }
    }
    assert!(balance.values().all(|count| *count == 0));
}

#[track_caller]
fn check_near(found: f64, expected: &serde_json::Value) {
    let expected = expected.as_f64().unwrap();
    assert!(
        (found - expected).abs() < 1e-6 * (1.0 + expected),
        "{found} {expected}"
    );
}

async fn cubes(server: &Server) -> String {
    let settings = r#"{"edge":3,"steps_per_unit":2,"stock":{"min":[0,0,0],"max":[5,5,5]}}"#;
    let scene = server.scene_with("cubes", settings).await;
    let mut random = Random::new(5);
    let cubes = (0..30).map(|id| {
        let at = [(); 3].map(|()| random.within(-2, 10) as f64 / 2.0);
        json!({"id": id, "at": at})
    });
    let change = json!({"insert": cubes.collect::<Vec<_>>()});
    server.change(&scene, &change.to_string()).await.ok();
    scene
}

async fn solids(server: &Server) -> String {
    let settings = json!({"kind": "solids", "steps_per_unit": 100, "stock": {"min": [0, 0, 0], "max": [10, 10, 4]},
        "shapes": {"tool": {"flat": {"diameter": 3, "length": 6, "sides": 16}}}});
    let scene = server.scene_with("solids", &settings.to_string()).await;
    let change = json!({"insert": [
        {"id": 1, "shape": "tool", "from": [2, 2, 2], "to": [8, 5, 2]},
        {"id": 2, "shape": "tool", "from": [8, 5, 2], "to": [3, 9, 1]},
    ]});
    server.change(&scene, &change.to_string()).await.ok();
    scene
}

#[tokio::test]
async fn meshes_have_the_volumes_of_the_mass_properties() {
    let server = Server::start().await;
    let scene = cubes(&server).await;
    let totals = server.totals(&scene).await;
    let parts = [
        ("union", &totals["volume"]),
        ("removed", &totals["removed"]["volume"]),
        ("remaining", &totals["remaining"]["volume"]),
    ];
    for (part, expected) in parts {
        let triangles = stl(&bytes(&server, &scene, &format!("part={part}")).await);
        check_closed(&triangles);
        check_near(volume(&triangles), expected);
    }
    let scene = solids(&server).await;
    let totals = server.totals(&scene).await;
    for part in ["removed", "remaining"] {
        let triangles = stl(&bytes(&server, &scene, &format!("part={part}")).await);
        check_closed(&triangles);
        check_near(volume(&triangles), &totals[part]["volume"]);
    }
}

#[tokio::test]
async fn every_format_has_the_same_triangles() {
    let server = Server::start().await;
    for scene in [cubes(&server).await, solids(&server).await] {
        let seq = server.totals(&scene).await["seq"].clone();
        let stl = stl(&bytes(&server, &scene, "part=remaining&format=stl").await).len();
        let answer = mesh(&server, &scene, "format=ply").await;
        let tag = answer.headers()["etag"].to_str().unwrap().to_owned();
        assert!(tag.ends_with(&format!("-{seq}\"")), "{tag}");
        let again = server.request("GET", &format!("{scene}/mesh?format=ply"));
        let again = again.header("if-none-match", &tag).send().await.unwrap();
        assert_eq!(again.status(), 304);
        assert_eq!(answer.headers()["content-type"], "application/ply");
        let name = answer.headers()["content-disposition"].to_str().unwrap();
        assert!(name.ends_with(".ply\""), "{name}");
        let length = answer.content_length().unwrap();
        let ply = answer.bytes().await.unwrap();
        assert_eq!(ply.len() as u64, length);
        let end = b"end_header\n";
        let head = ply.windows(end.len()).position(|text| text == end);
        let head = head.unwrap() + end.len();
        let text = std::str::from_utf8(&ply[..head]).unwrap();
        let count = |name: &str| -> usize {
            let mut lines = text.lines();
            let found = lines.find_map(|line| line.strip_prefix(&format!("element {name} ")));
            found.unwrap().parse().unwrap()
        };
        let (vertices, triangles) = (count("vertex"), count("face"));
        assert_eq!(triangles, stl);
        assert_eq!(ply.len(), head + 24 * vertices + 13 * triangles);

        let obj = String::from_utf8(bytes(&server, &scene, "format=obj").await).unwrap();
        let lines = |mark: &str| obj.lines().filter(|line| line.starts_with(mark)).count();
        assert_eq!((lines("v "), lines("f ")), (vertices, triangles));

        let glb = bytes(&server, &scene, "format=glb").await;
        assert_eq!(&glb[..4], b"glTF");
        let whole = u32::from_le_bytes(number(&glb, 8));
        assert_eq!(glb.len(), usize::try_from(whole).unwrap());
        let json = usize::try_from(u32::from_le_bytes(number(&glb, 12))).unwrap();
        let json: serde_json::Value = serde_json::from_slice(&glb[20..20 + json]).unwrap();
        assert_eq!(json["accessors"][1]["count"], 3 * triangles);

        let zip = bytes(&server, &scene, "format=3mf").await;
        assert_eq!(&zip[..4], b"PK\x03\x04");
    }
}

#[tokio::test]
async fn boxes_share_out_the_mesh() {
    let server = Server::start().await;
    for (scene, step) in [(cubes(&server).await, 0.5), (solids(&server).await, 0.01)] {
        let whole = stl(&bytes(&server, &scene, "").await);
        let far = 1_000;
        let low = format!("box=-{far},-{far},-{far},{},{far},{far}", 3.0 - step);
        let high = format!("box=3,-{far},-{far},{far},{far},{far}");
        let mut parts = stl(&bytes(&server, &scene, &low).await);
        parts.extend(stl(&bytes(&server, &scene, &high).await));
        let (parts, whole) = (volume(&parts), volume(&whole));
        assert!((parts - whole).abs() < 1e-4 * whole, "{parts} {whole}");
    }
}

#[tokio::test]
async fn what_cannot_be_answered_is_refused_with_its_place() {
    let server = Server::start().await;
    let scene = cubes(&server).await;
    let bare = server.scene("bare", 2).await;
    for (scene, query, parameter) in [
        (&scene, "part=rest", "part"),
        (&bare, "part=remaining", "part"),
        (&bare, "part=removed", "part"),
        (&scene, "format=step", "format"),
        (&scene, "box=0,0,0,1,1", "box"),
        (&scene, "box=0,0,0,1,1,nan", "box"),
        (&scene, "box=0,0,2,1,1,1", "box"),
        (&scene, "at-most=11", "at-most"),
        (&scene, "at-most=-1", "at-most"),
        (&scene, "color=red", "color"),
    ] {
        let answer = server.get(&format!("{scene}/mesh?{query}")).await;
        let problem = answer.problem(422, "invalid");
        assert_eq!(problem["errors"][0]["parameter"], parameter, "{problem}");
    }
    // Nothing is there, which is a mesh, too.
    for format in ["stl", "ply", "obj", "3mf", "glb"] {
        let none = bytes(&server, &bare, &format!("at-most=0&format={format}")).await;
        assert!(!none.is_empty(), "{format}");
    }
    let all = stl(&bytes(&server, &scene, "").await).len();
    let enough = bytes(&server, &scene, &format!("at-most={all}")).await;
    assert_eq!(stl(&enough).len(), all);
    let fewer = server
        .get(&format!("{scene}/mesh?at-most={}", all - 1))
        .await;
    fewer.problem(422, "invalid");
}
