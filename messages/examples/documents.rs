//! Writes `docs/reference/schemas/*.json` and `docs/reference/asyncapi.json` from the types.
//!
//! `cargo run -p verge-messages --features schema --example documents`

use verge_messages::asyncapi::{documents, text};

fn main() -> std::io::Result<()> {
    for (path, document) in documents() {
        let path = format!("{}/../docs/reference/{path}", env!("CARGO_MANIFEST_DIR"));
        std::fs::write(&path, text(&document))?;
        println!("{path}");
    }
    Ok(())
}
