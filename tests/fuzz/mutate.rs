//! Mutations of inputs: bit flips, splices, truncation, edits of length fields, tokens.
//!
//! Everything comes from one seeded generator: a run is repeated by its seed.

use fastrand::Rng;

/// Most mutations that are put on top of each other.
const STACKED: usize = 6;

/// Lengths and counts at which readers go wrong.
const EDGES: [u32; 14] = [
    0,
    1,
    2,
    0x7f,
    0x80,
    0xff,
    0x100,
    0x7fff,
    0x8000,
    0xffff,
    0x0001_0000,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
];

/// A new input out of the corpus, at most `longest` bytes.
pub fn mutated(rng: &mut Rng, corpus: &[Vec<u8>], tokens: &[&[u8]], longest: usize) -> Vec<u8> {
    let mut input = corpus[rng.usize(..corpus.len())].clone();
    for _ in 0..rng.usize(1..=STACKED) {
        mutate(rng, &mut input, corpus, tokens);
    }
    input.truncate(longest);
    input
}

fn mutate(rng: &mut Rng, input: &mut Vec<u8>, corpus: &[Vec<u8>], tokens: &[&[u8]]) {
    let at = rng.usize(..=input.len());
    let (from, to) = range(rng, input.len());
    match rng.u8(..11) {
        0 | 1 if !input.is_empty() => {
            let bit = rng.usize(..input.len() * 8);
            input[bit / 8] ^= 1 << (bit % 8);
        }
        2 => {
            if let Some(byte) = input.get_mut(at) {
                *byte = rng.u8(..);
            }
        }
        3 => input.truncate(at),
        4 => drop(input.drain(from..to)),
        5 => {
            let copy = input[from..to].to_vec();
            input.splice(at..at, copy);
        }
        6 => {
            let other = &corpus[rng.usize(..corpus.len())];
            let (from, to) = range(rng, other.len());
            let behind = if rng.bool() { at } else { input.len() };
            input.splice(at..behind, other[from..to].iter().copied());
        }
        7 => overwrite(input, at, &edge(rng)),
        8 if !tokens.is_empty() => {
            let token = tokens[rng.usize(..tokens.len())];
            input.splice(at..at, token.iter().copied());
        }
        9 if !tokens.is_empty() => overwrite(input, at, tokens[rng.usize(..tokens.len())]),
        _ => {
            let noise: Vec<u8> = (0..rng.usize(1..16)).map(|_| rng.u8(..)).collect();
            input.splice(at..at, noise);
        }
    }
}

/// A part of `len` bytes, mostly a short one.
fn range(rng: &mut Rng, len: usize) -> (usize, usize) {
    let from = rng.usize(..=len);
    let most = if rng.u8(..4) == 0 { len - from } else { (len - from).min(32) };
    (from, from + rng.usize(..=most))
}

/// An edge value as a length field of one, two or four bytes, either end first.
fn edge(rng: &mut Rng) -> Vec<u8> {
    let value = EDGES[rng.usize(..EDGES.len())];
    match rng.u8(..5) {
        0 => vec![value as u8],
        1 => (value as u16).to_be_bytes().to_vec(),
        2 => (value as u16).to_le_bytes().to_vec(),
        3 => value.to_be_bytes().to_vec(),
        _ => value.to_le_bytes().to_vec(),
    }
}

fn overwrite(input: &mut [u8], at: usize, with: &[u8]) {
    for (byte, new) in input.iter_mut().skip(at).zip(with) {
        *byte = *new;
    }
}
