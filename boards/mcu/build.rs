//! Gives the linker the workspace's memory.x, and tells it which program is the eye core, which
//! has a budget of its own there.

fn main() {
    println!("cargo::rerun-if-changed=../../memory.x");
    if std::env::var("CARGO_CFG_TARGET_OS").as_deref() == Ok("none") {
        let root = std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets it") + "/../..";
        println!("cargo::rustc-link-search={root}");
        println!("cargo::rustc-link-arg-bin=eye_core=--defsym=_eye_core=1");
        println!("cargo::rustc-link-arg=-Tlink.x");
    }
}
