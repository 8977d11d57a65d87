// RUN: tai-opt %s --verify-roundtrip | FileCheck %s
// RUN: tai-opt %s --emit-bytecode | tai-opt | FileCheck %s

// All kinds of level nest, and print without the dialect's prefix.
// CHECK: tai.tree @sparse : !tai.root<pointer<[i: 64, j: 64], bitmasked<[i: 8, j: 8], {m: f32, v: vector<2xf32>}>>, hash<[k: 1000000], dense<[k: 4], {h: i32}>>, dynamic<[l: 1024], chunk 32, {p: f64}>>
tai.tree @sparse : !tai.root<
  pointer<[i: 64, j: 64], bitmasked<[i: 8, j: 8], {m: f32, v: vector<2xf32>}>>,
  hash<[k: 1000000], dense<[k: 4], {h: i32}>>,
  dynamic<[l: 1024], chunk 32, {p: f64}>>

// Places at the root have no index; names that are no keywords are quoted.
// CHECK: tai.tree @mixed : !tai.root<dense<[i: 3], {a: i1, b: f16, "0": vector<3x3xf64>}, {c: bf16}>, {loss: f32}>
tai.tree @mixed : !tai.root<
  dense<[i: 3], {a: i1, b: f16, "0": vector<3x3xf64>}, {c: bf16}>, {loss: f32}>

// A level may divide an axis that a level above divides too, by any extent.
// CHECK: tai.tree @blocked : !tai.root<dense<[i: 5], dense<[i: 7, t: 2], {x: i64}>>>
tai.tree @blocked : !tai.root<dense<[i: 5], dense<[i: 7, t: 2], {x: i64}>>>

// A record of places is a type of its own as well.
// CHECK: func.func private @record() attributes {type = !tai.places<{a: f32, b: i8}>}
func.func private @record() attributes {type = !tai.places<{a: f32, b: i8}>}

// So is a level.
// CHECK: func.func private @level() attributes {type = !tai.dense<[i: 2], {a: f32}>}
func.func private @level() attributes {type = !tai.dense<[i: 2], {a: f32}>}
