//===- Passes.td - Passes on sharded fields ----------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
//===----------------------------------------------------------------------===//

#ifndef TAI_TRANSFORMS_SHARDS_PASSES_TD
#define TAI_TRANSFORMS_SHARDS_PASSES_TD

include "mlir/Pass/PassBase.td"

def Shard : Pass<"tai-shard", "::mlir::ModuleOp"> {
  let summary = "divide loops over sharded fields among ranks";
  let description = [{
    Each rank of a mesh runs the same kernel. In a parallel loop that accesses
    fields below a `shard` level, this pass

    - clips the bounds of the loop to the iterations of the rank: the owner of
      the row that an iteration stores (else the row that it adds to, else the
      first that it reads) runs the iteration;
    - fetches, before the loop, the rows of other ranks that the loop reads;
    - clears these rows before the loop where it adds to them, and adds them to
      the rows of their owners after it;
    - combines, after the loop, the additions, minima and maxima of all ranks to
      a field that is not sharded;
    - notes, after the loop, which fields it changes, so that halos that are
      current are not fetched again.

    Each rank runs all iterations, on all rows, which it gathers before, if the
    loop adds up floats in a deterministic kernel, so that the sum has the bits
    that it has in one process, and if it fills memory of the kernel for later
    loops, as adjoints of minima and maxima do.

    With `gathers`, additions to shifted rows, as adjoints of stencils make them,
    first become gathers (see `tai-scatter-to-gather`), so that the loop fetches
    rows that it reads, and collects none. A loop stays as it is if ranks could
    not run its gathering form, or if that form has additions to other rows, too.

    Indices and addresses remain those of the whole field. Other loops, which
    all ranks run alike, and programs without a `shard` level do not change. See
    docs/decisions/0075-shards.md.

    The index along the axis of a shard must be the index of the loop plus a
    constant, or a value that the analysis of indices bounds relative to it, as
    for `max(i - 1, 0)` and `i + k` in a loop over `k`. An error reports any
    other access to a sharded field, and stores to fields of which each rank has
    a copy.

    In a loop with the attribute `tai_mesh.halo = n`, data may choose the rows:
    the program promises that they are those of the rank and `n` rows on either
    side, which are fetched and collected as other halos are. The launch fails
    at a row beyond. With -1 they are all rows, which ranks gather or sum up.

    With fields of 64 rows on 4 ranks,

    ```mlir
    tai.parallel_for (%i) = (%c1) to (%c64) {
      %h = arith.subi %i, %c1 : index
      %0 = tai.load @x[%h] : f32
      tai.store %0, @y[%i] : f32
    }
    // becomes, with the bounds %a and %b that follow from the rank
    %rank = tai_mesh.rank of 4
    tai_mesh.exchange fetch @x before 1
    tai.parallel_for (%i) = (%a) to (%b) {
      // the same
    }
    ```
  }];
  let options = [
    Option<"gathers", "gathers", "bool", /*default=*/"false",
           "Gather additions to rows of other ranks where that is possible">,
    Option<"pairSums", "pair-sums", "bool", /*default=*/"true",
           "As for tai-scatter-to-gather">,
    Option<"onDevice", "on-device", "bool", /*default=*/"false",
           "As for tai-scatter-to-gather">];
  let dependentDialects = ["::mlir::arith::ArithDialect",
                           "::mlir::scf::SCFDialect",
                           "::mlir::tai::TaiMeshDialect",
                           "::mlir::tai::TaiDialect"];
}

#endif // TAI_TRANSFORMS_SHARDS_PASSES_TD
