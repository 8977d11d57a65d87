// RUN: tai-opt %s --split-input-file --tai-shard --verify-diagnostics

// expected-error @+1 {{expects 'dense' levels above a 'shard' level, but got 'pointer'}}
tai.tree @t : !tai.root<pointer<[j: 4], !tai_mesh.shard<[i: 2], dense<[i: 8], {x: f32}>>>>

// -----

// expected-error @+1 {{has a level above a 'shard' level that divides axis 'i', too}}
tai.tree @t : !tai.root<dense<[i: 4], !tai_mesh.shard<[i: 2], dense<[i: 8], {x: f32}>>>>

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, n: i32}>, dense<[i: 32], {half: f32}>>, {loss: f32, h: f16}, dense<[i: 64], {w: f32}>, bitmasked<[i: 64], {s: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1
tai.field @half = @t["half"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.field @h = @t["h"] : f16, rank 0
tai.field @w = @t["w"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 1

tai.kernel @serial() -> f32 {
  %c3 = arith.constant 3 : index
  // expected-error @+1 {{cannot run on several ranks: outside of a parallel loop, it accesses '@x', which is sharded}}
  %0 = tai.load @x[%c3] : f32
  tai.return %0 : f32
}

// -----

!t = !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, n: i32}>, dense<[i: 32], {half: f32}>>, {loss: f32, h: f16}, dense<[i: 64], {w: f32}>, bitmasked<[i: 64], {s: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1
tai.kernel @data() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @n[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    // expected-error @+1 {{cannot run on several ranks: the index of '@x' along its sharded axis is not the index of the loop plus a constant}}
    %2 = tai.load @x[%1] : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @wrapped() {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) in @x {
    %0 = arith.addi %i, %c1 : index
    %1 = arith.remui %0, %c64 : index
    // expected-error @+1 {{cannot run on several ranks: it reaches 63 rows of 'x' beyond its own, and a rank has 16}}
    %2 = tai.load @x[%1] : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.kernel @stores() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
    %1 = arith.addi %i, %c1 : index
    // expected-error @+1 {{cannot run on several ranks: it stores to a row of '@y' other than the row that decides which rank runs the iteration}}
    tai.store %0, @y[%1] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>, dense<[i: 32], {half: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @half = @t["half"] : f32, rank 1
tai.kernel @blocks() {
  tai.parallel_for (%i) in @half {
    %0 = tai.load @half[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: the loop accesses fields of 8 and of 16 rows for each rank}}
    tai.store %0, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @copy() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: the loop accesses a sharded field, and writes to '@loss', of which each rank has a copy; atomic additions, minima and maxima are possible}}
    tai.store %0, @loss[] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @old() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: it reads the old value of an element of 'loss', to which other ranks add, too}}
    %1 = tai.atomic add %0, @loss[] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @product() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: ranks combine their copies of '@loss' by sums, minima and maxima alone}}
    %1 = tai.atomic mul %0, @loss[] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>, {loss: f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0
tai.kernel @reads() {
  tai.parallel_for (%i) in @x {
    // expected-error @+1 {{cannot run on several ranks: the loop reads '@loss', and combines it over ranks}}
    %0 = tai.load @loss[] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.mulf %0, %1 : f32
    %3 = tai.atomic add %2, @loss[] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>, {h: f16}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @h = @t["h"] : f16, rank 0
tai.kernel @halves() {
  %0 = arith.constant 1.0 : f16
  tai.parallel_for (%i) in @x {
    // expected-error @+1 {{cannot run on several ranks: it combines numbers of 'f16' with those of other ranks}}
    %1 = tai.atomic add %0, @h[] : f16
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.kernel @both() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = arith.addi %i, %c1 : index
    %1 = tai.load @y[%0] : f32
    tai.store %1, @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: the loop adds to rows of '@y' of another rank, and reads such rows}}
    %2 = tai.atomic add %1, @y[%0] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.kernel @most() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c0) to (%c63) {
    %0 = arith.addi %i, %c1 : index
    %1 = tai.load @x[%i] : f32
    tai.store %1, @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: it combines a value with a row of another rank, and is no addition}}
    %2 = tai.atomic max %1, @y[%0] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @random() {
  tai.parallel_for (%i) in @x {
    // expected-error @+1 {{cannot run on several ranks: random numbers depend on the number of the iteration, which a rank does not know}}
    %0 = tai.random stream 0 : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @array(%a: memref<?xf32>) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: the loop accesses a sharded field, and writes to an array, of which each rank has a copy}}
    memref.store %0, %a[%i] : memref<?xf32>
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>, bitmasked<[i: 64], {s: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 1
tai.kernel @cells() {
  // expected-error @+1 {{cannot run on several ranks: the loop visits the active cells of '@s', and accesses a sharded field}}
  tai.parallel_for (%i) in @s {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @ordered() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  // expected-error @+1 {{cannot run on several ranks: the loop accesses a sharded field, and its iterations run one after another}}
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
  } {serialize}
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[j: 4], dense<[i: 4, j: 64], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 2
tai.kernel @in_place(%s: index, %t: index) {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%j) = (%c1) to (%c64) {
    %0 = arith.subi %j, %c1 : index
    // expected-error @+1 {{cannot run on several ranks: it reads a row of '@x' that another iteration of the loop stores}}
    %1 = tai.load @x[%s, %0] : f32
    tai.store %1, @x[%t, %j] : f32
  }
  tai.return
}
