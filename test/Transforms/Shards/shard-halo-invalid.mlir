// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-shard

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, at: i32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @at = @t["at"] : i32, rank 1
tai.kernel @store() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: it stores to a row of '@y' that data choose, which is possible with halo=0, for rows of the rank itself}}
    tai.store %2, @y[%1] : f32
  } {tai_mesh.halo = 1 : i64}
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, at: i32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @at = @t["at"] : i32, rank 1
tai.kernel @wide() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: the loop has halo=17, and a rank has 16 rows of '@y'}}
    tai.atomic add %2, @y[%1] : f32
  } {tai_mesh.halo = 17 : i64}
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, at: i32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @at = @t["at"] : i32, rank 1
tai.kernel @largest() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: it combines a value with a row of another rank, and is no addition}}
    tai.atomic max %2, @y[%1] : f32
  } {tai_mesh.halo = -1 : i64}
  tai.return
}

// -----

tai.tree @t : !tai.root<!tai_mesh.shard<[i: 4], dense<[i: 64], {x: f32, y: f32, at: i32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @at = @t["at"] : i32, rank 1
tai.kernel @both() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @at[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    // expected-error @+1 {{cannot run on several ranks: the loop reads and changes rows of '@x' that data choose}}
    tai.atomic add %2, @x[%1] : f32
  } {tai_mesh.halo = -1 : i64}
  tai.return
}
