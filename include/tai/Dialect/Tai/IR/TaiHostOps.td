//===- TaiHostOps.td - Launches and tapes ------------------*- tablegen -*-===//
//
// Licensed under the Apache License v2.0 with LLVM Exceptions.
// SPDX-License-Identifier: Apache-2.0 WITH LLVM-exception
//
// Ops in a `func.func` that runs on the host. `tai.load` and `tai.store` are
// also allowed there, for single elements.
//
//===----------------------------------------------------------------------===//

#ifndef TAI_DIALECT_TAI_IR_TAIHOSTOPS_TD
#define TAI_DIALECT_TAI_IR_TAIHOSTOPS_TD

include "tai/Dialect/Tai/IR/TaiOpBase.td"

let opDocGroup = HostOpGroup in {

def Tai_LaunchOp : Tai_Op<"launch", [
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "run a kernel";
  let description = [{
    Runs the kernel with the given arguments, and waits for its result if it has
    one. Inside `tai.tape` the launch is recorded, to be reversed.

    1. (launch_c1) `kernel` names a `tai.kernel`.
    2. (launch_c2) Operands and results have the types of those of the kernel.
    3. (launch_c3) It stands in no kernel, but in a function of the host.

    Example:

    ```mlir
    tai.launch @step(%t) : (i32) -> ()
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$kernel, Variadic<AnyType>:$operands);
  let results = (outs Variadic<AnyType>:$results);
  let assemblyFormat = [{
    $kernel `(` $operands `)` attr-dict `:` functional-type($operands, $results)
  }];
}

def Tai_TapeOp : Tai_Op<"tape", [
    SingleBlockImplicitTerminator<"YieldOp">, RecursiveMemoryEffects,
    Tai_RecordsLaunches,
    DeclareOpInterfaceMethods<SymbolUserOpInterface>]> {
  let summary = "record launches and propagate gradients back through them";
  let description = [{
    Clears the adjoint fields and the loss, runs the region and records its
    launches, sets the adjoint of `loss` (a 0-D field with an adjoint) to one, and then runs
    the adjoints of the recorded launches in reverse order with the recorded
    arguments (paper, section 3.2). Launches that cannot reach the loss are
    skipped.

    Only launches are recorded. A number that a launch returns or the host reads
    from a field with an adjoint must not reach another launch or a field except
    through `tai.stop_gradient`, and the host must not store to a field that an
    earlier launch has accessed. Arithmetic on numbers from before the tape is
    unrestricted.

    1. (tape_c1) `loss` names a `tai.field` of a float, of rank 0.
    2. (tape_c2) The loss has an adjoint.
    3. (tape_c3) No value with a derivative goes from one launch to the next
       through the host.
    4. (tape_c4) It stands in no other tape, and in no kernel.

    With `checkpoint`, launches are run again in the reverse sweep instead of
    saving all values that adjoints need.

    Example:

    ```mlir
    tai.tape loss(@loss) {
      tai.launch @step(%t) : (i32) -> ()
      tai.launch @compute_loss() : () -> ()
    }
    tai.tape loss(@loss) checkpoint(<mixed budget 1000000>) {
      tai.launch @step(%t) : (i32) -> ()
    }
    ```
  }];
  let arguments = (ins FlatSymbolRefAttr:$loss,
                       OptionalAttr<Tai_CheckpointAttr>:$checkpoint);
  let regions = (region SizedRegion<1>:$body);
  let assemblyFormat = [{
    `loss` `(` $loss `)` (`checkpoint` `(` $checkpoint^ `)`)? $body attr-dict
  }];
}

} // opDocGroup = HostOpGroup

#endif // TAI_DIALECT_TAI_IR_TAIHOSTOPS_TD
