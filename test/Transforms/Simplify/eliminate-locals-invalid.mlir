// RUN: tai-opt %s --tai-eliminate-locals --split-input-file --verify-diagnostics

// Iterations that run at the same time cannot share a variable.
tai.kernel @shared(%n: index, %m: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  // expected-note @+1 {{the variable is made here}}
  %s = tai.alloca : !tai.local<f32>
  // expected-note @+1 {{the iterations of this loop may run at the same time; sum into a field with 'tai.atomic add', or make the variable inside the loop}}
  tai.parallel_for (%i) = (%c0) to (%n) {
    // expected-error @+1 {{a local variable cannot be used across 'tai.parallel_for'}}
    %0 = tai.local_load %s : f32
    memref.store %0, %m[%i] : memref<?xf32>
  }
  tai.return
}

// -----

func.func @region(%a: f32) -> f32 {
  // expected-note @+1 {{the variable is made here}}
  %s = tai.alloca : !tai.local<f32>
  scf.execute_region {
    // expected-error @+1 {{a local variable cannot be used across 'scf.execute_region'}}
    tai.local_store %a, %s : f32
    scf.yield
  }
  %r = tai.local_load %s : f32
  return %r : f32
}

// -----

func.func private @take(!tai.local<f32>)
func.func @escapes() {
  %s = tai.alloca : !tai.local<f32>
  // expected-error @+1 {{uses a local variable in a way that cannot be turned into values}}
  func.call @take(%s) : (!tai.local<f32>) -> ()
  return
}
