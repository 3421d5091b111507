//! Holds the documents to themselves and to the reference that is generated from the code.

mod blocks;
mod figures;
mod links;
mod names;
mod pages;
