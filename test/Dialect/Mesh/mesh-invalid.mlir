// RUN: tai-opt %s --split-input-file --verify-diagnostics

// expected-error @+1 {{has 3 ranks, which do not divide the extent 64 of axis 'i'}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 3], dense<[i: 64], {x: f32}>>>

// -----

// expected-error @+1 {{expects a level below that divides axis 'i', along which it is sharded}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 2], dense<[j: 64], {x: f32}>>>

// -----

// expected-error @+1 {{expects one level below that divides axis 'i', but got two}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 2], dense<[i: 8], dense<[i: 8], {x: f32}>>>>

// -----

// expected-error @+1 {{expects 'dense' levels below, but got 'pointer'}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 2], pointer<[i: 8], {x: f32}>>>

// -----

// expected-error @+1 {{expects 'dense' levels below, but got 'shard'}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 2], !tai_mesh.shard<[j: 2], dense<[i: 8, j: 8], {x: f32}>>>>

// -----

// expected-error @+1 {{expects a positive number of ranks, but got 0}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 0], dense<[i: 8], {x: f32}>>>

// -----

// expected-error @+1 {{expects one axis, but got 2}}
tai.tree @t : !tai.root<!tai_mesh.shard<[i: 2, j: 2], dense<[i: 8], {x: f32}>>>

// -----

tai.kernel @none() {
  // expected-error @+1 {{names '@x', which is not a field}}
  tai_mesh.exchange sum @x
  tai.return
}

// -----

tai.tree @t : !tai.root<pointer<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @sparse() {
  // expected-error @+1 {{expects a field without sparse levels, but '@x' is below a 'pointer' level}}
  tai_mesh.exchange sum @x
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 4, j: 8], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @kinds() {
  // expected-error @+1 {{'min' expects a field that is not below a 'shard' level}}
  tai_mesh.exchange min @x
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 4, j: 8], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @rows() {
  // expected-error @+1 {{'fetch' expects a field that is below a 'shard' level}}
  tai_mesh.exchange fetch @loss
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 4, j: 8], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @wide() {
  // expected-error @+1 {{expects halos of 0 to 4 rows, but got 1 and 5}}
  tai_mesh.exchange fetch @x before 1 after 5
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 4, j: 8], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @copies() {
  // expected-error @+1 {{expects halos of 0 to 0 rows, but got 1 and 0}}
  tai_mesh.exchange sum @loss before 1
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 4, j: 8], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @number(%t: index) {
  // expected-error @+1 {{expects a dimension for each index, but got 2 and 1}}
  tai_mesh.exchange fetch @x before 1 at[%t] dims [0, 1]
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 2], dense<[i: 4, j: 8], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @sharded(%t: index) {
  // expected-error @+1 {{expects ascending dimensions of '@x' without the sharded one, but got 1}}
  tai_mesh.exchange fetch @x before 1 at[%t] dims [1]
  tai.return
}

// -----

tai.tree @t : !tai.root<{loss: f32}>
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @gather() {
  // expected-error @+1 {{'gather' expects a field that is below a 'shard' level}}
  tai_mesh.exchange gather @loss
  tai.return
}

// -----

tai.tree @t : !tai.root<{loss: f32}>
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @stale() {
  // expected-error @+1 {{'stale' expects a field that is below a 'shard' level}}
  tai_mesh.exchange stale @loss
  tai.return
}
