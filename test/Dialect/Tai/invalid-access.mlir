// RUN: tai-opt %s --split-input-file --verify-diagnostics

tai.kernel @load(%i: index) {
  // (load_c1)
  // expected-error @+1 {{'tai.load' op names '@x', which is not a field}}
  %0 = tai.load @x[%i] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4, j: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 2
tai.kernel @load(%i: index) {
  // (load_c2)
  // expected-error @+1 {{'tai.load' op expects 2 indices, but got 1}}
  %0 = tai.load @x[%i] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: vector<2xf32>}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : vector<2xf32>, rank 1
tai.kernel @load(%i: index) {
  // (load_c4)
  // expected-error @+1 {{'tai.load' op expects a value of type 'vector<2xf32>', but got 'f32'}}
  %0 = tai.load @x[%i] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @store(%i: index, %f: f32) {
  // (store_c3)
  // expected-error @+1 {{'tai.store' op expects 0 component indices, but got 1}}
  tai.store %f, @x[%i] component [%i] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: vector<2xf32>}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : vector<2xf32>, rank 1
tai.kernel @store(%i: index, %f: f64) {
  // (store_c4)
  // expected-error @+1 {{'tai.store' op expects a value of type 'f32', but got 'f64'}}
  tai.store %f, @x[%i] component [%i] : f64
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @atomic(%i: index, %f: f32) {
  // (atomic_c5)
  // expected-error @+1 {{'tai.atomic' op 'xor' expects integers, but got 'f32'}}
  %0 = tai.atomic xor %f, @x[%i] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @unsigned(%i: index, %f: f32) {
  // (atomic_c5)
  // expected-error @+1 {{'tai.atomic' op 'minu' expects integers, but got 'f32'}}
  %0 = tai.atomic minu %f, @x[%i] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @activate(%i: index) {
  // expected-error @+1 {{'tai.activate' op names level 2, but the path to the field has fewer}}
  tai.activate @x[%i] level 2
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @append(%f: f32) {
  // expected-error @+1 {{'tai.append' op expects a field below a 'dynamic' level}}
  %0 = tai.append %f, @x[] : f32
  tai.return
}

// -----

tai.tree @t : !tai.root<dynamic<[i: 4], chunk 2, {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @append(%f: f64) {
  // expected-error @+1 {{'tai.append' op expects a value of type 'f32', but got 'f64'}}
  %0 = tai.append %f, @x[] : f64
  tai.return
}

// -----

tai.tree @t : !tai.root<dynamic<[i: 4], chunk 2, {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @length(%i: index) {
  // expected-error @+1 {{'tai.length' op expects 0 indices, those of the list, but got 1}}
  %0 = tai.length @x[%i]
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[j: 2, i: 4], dynamic<[i: 4], chunk 2, {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 2
tai.kernel @length(%i: index) {
  // expected-error @+1 {{'tai.length' op names a list along axis 'i', which a level above divides as well; the indices do not say which list it is}}
  %0 = tai.length @x[%i]
  tai.return
}
