// RUN: tai-opt %s --split-input-file --verify-diagnostics

// expected-error @+1 {{expected an axis, a letter from 'i' to 't', but got 'a'}}
tai.tree @t : !tai.root<dense<[a: 4], {x: f32}>>

// -----

// expected-error @+1 {{expected a level ('dense', 'pointer', 'bitmasked', 'hash', 'dynamic', a level type of another dialect) or places in braces, but got 'sparse'}}
tai.tree @t : !tai.root<sparse<[i: 4], {x: f32}>>

// -----

// expected-error @+1 {{expects levels or places as children, but got '!tai.local<f32>'}}
tai.tree @t : !tai.root<!tai.local<f32>>

// -----

// expected-error @+1 {{divides axis 'i' twice}}
tai.tree @t : !tai.root<dense<[i: 4, i: 4], {x: f32}>>

// -----

// expected-error @+1 {{expects a positive extent along axis 'j', but got 0}}
tai.tree @t : !tai.root<dense<[i: 4, j: 0], {x: f32}>>

// -----

// expected-error @+1 {{expects at least one axis}}
tai.tree @t : !tai.root<dense<[], {x: f32}>>

// -----

// expected-error @+1 {{has more cells than a 64-bit number can count}}
tai.tree @t : !tai.root<hash<[i: 9223372036854775807, j: 2], {x: f32}>>

// -----

// Its size would be 8 as a 64-bit number.
// expected-error @+1 {{has more bytes than can be addressed}}
tai.tree @t : !tai.root<dense<[i: 2305843009213693953], {x: f64}>>

// -----

// expected-error @+1 {{has more bytes than can be addressed}}
tai.tree @t : !tai.root<{x: i8}, pointer<[i: 4294967296], dense<[i: 4294967296], {x: f32}>>>

// -----

// expected-error @+1 {{has more bytes than can be addressed}}
tai.tree @t : !tai.root<{x: vector<4294967296x4294967296xf32>}>

// -----

// expected-error @+1 {{expects at least one place}}
tai.tree @t : !tai.root<{}>

// -----

// expected-error @+1 {{place 'x' has type 'tensor<2xf32>'; expects i1, i8, i16, i32, i64, f16, bf16, f32, f64, or a vector of one with one or two dimensions}}
tai.tree @t : !tai.root<{x: tensor<2xf32>}>

// -----

// expected-error @+1 {{place 'x' has type 'vector<2x2x2xf32>'}}
tai.tree @t : !tai.root<{x: vector<2x2x2xf32>}>

// -----

// expected-error @+1 {{expects places to have names}}
tai.tree @t : !tai.root<{"": f32}>

// -----

// expected-error @+1 {{expects a positive chunk size, but got 0}}
tai.tree @t : !tai.root<dynamic<[i: 8], chunk 0, {x: f32}>>

// -----

// expected-error @+1 {{'tai.tree' op has two places named 'x'}}
tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>, {x: i32}>

// -----

// expected-error @+1 {{'tai.field' op names '@t', which is not a tree}}
tai.field @x = @t["x"] : f32, rank 1

// -----

// expected-note @+1 {{tree declared here}}
tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op names place 'y', which the tree does not have}}
tai.field @y = @t["y"] : f32, rank 1

// -----

// expected-note @+1 {{tree declared here}}
tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op has type 'f64', but place 'x' holds 'f32'}}
tai.field @x = @t["x"] : f64, rank 1

// -----

// expected-note @+1 {{tree declared here}}
tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op has rank 2, but the path to place 'x' divides 1 axes}}
tai.field @x = @t["x"] : f32, rank 2

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op expects 1 offsets, but got 2}}
tai.field @x = @t["x"] : f32, rank 1, offset [1, 2]

// -----

tai.tree @t : !tai.root<dense<[i: 4, j: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op expects an order that lists each axis of its path once}}
tai.field @x = @t["x"] : f32, rank 2, order [0, 0]

// -----

// expected-error @+1 {{'offset' is given twice}}
tai.field @x = @t["x"] : f32, rank 1, offset [1], offset [2]

// -----

// expected-error @+1 {{expected 'adjoint', 'dual', 'offset', 'order' or 'initial', but got 'grad'}}
tai.field @x = @t["x"] : f32, rank 1, grad @y

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op adjoint '@x_grad' is not a field}}
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32, g: f64}>>
// expected-note @+1 {{it has type 'f64' and rank 1}}
tai.field @g = @t["g"] : f64, rank 1
// expected-error @+1 {{'tai.field' op expects dual '@g' to have type 'f32' and rank 1}}
tai.field @x = @t["x"] : f32, rank 1, dual @g

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: vector<2xf32>}>>
// expected-error @+1 {{'tai.field' op expects initial contents of type 'tensor<4x2xf32>', but got 'tensor<4xf32>'}}
tai.field @x = @t["x"] : vector<2xf32>, rank 1, initial dense<1.0> : tensor<4xf32>

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op expects initial contents of type 'tensor<4xf32>', but got 'tensor<4xf64>'}}
tai.field @x = @t["x"] : f32, rank 1, initial dense<1.0> : tensor<4xf64>

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'tai.field' op expects initial contents as dense elements}}
tai.field @x = @t["x"] : f32, rank 1, initial sparse<[[1]], [2.0]> : tensor<4xf32>

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-error @+1 {{'initial' is given twice}}
tai.field @x = @t["x"] : f32, rank 1, initial dense<1.0> : tensor<4xf32>, initial dense<1.0> : tensor<4xf32>
